
/* The state of the loop. */
typedef struct {
    @_plan plan;
    @_real u[$_M]; /* the input returned last: with rates, write here what was applied if it was another one */
    int held;      /* calls in a row without a state; -1 before the first plan */
} @;

static inline void @_start(@ *s)
{
    @_blank(&s->plan);
    for (int j = 0; j < $_M; ++j)
        s->u[j] = @_begin[j];
    s->held = -1;
}

/* The first input of the best plan from the states y; a state that cannot be true goes on by the last plan. */
static inline int @_step(@ *s, const @_real *y, @_real *u)
{
    int code = $_OK;
    for (int i = 0; i < $_N; ++i)
        if (!@_fits(y[i], @_most[i]))
            code = $_HELD;
    if (code == $_OK)
        code = @_solve(&s->plan, y, s->u);
    if (code != $_HELD)
        s->held = 0;
    else if (s->held >= 0 && s->held < $_STEPS - 1)
        ++s->held;
    for (int j = 0; j < $_M; ++j) {
        if (s->held >= 0)
            s->u[j] = $_R(s->plan.u[s->held * $_M + j]);
        u[j] = s->u[j];
    }
    return code;
}
