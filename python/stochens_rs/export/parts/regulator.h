
/* The state of the loop. */
typedef struct {
    @_plan plan;
    @_real u[$_M]; /* the input returned last: with rates, write here what was applied if it was another one */
    @_real last[$_M]; /* the same, where that cannot be true */
    int held;      /* calls in a row without a state; -1 before the first plan */
} @;

/* From the next call on to these states: $_TARGETS rows, one that stays or one for each step of a plan. */
static inline int @_target(@ *s, const @_real *target)
{
    int code = $_OK;
    for (int i = 0; i < $_TARGETS * $_N; ++i)
        if (!@_fits(target[i], @_most[i % $_N]))
            code = $_HELD;
    for (int i = 0; i < $_ALL && code == $_OK; ++i) {
        @_wide v = @_offset[i];
        for (int j = 0; j < $_TARGETS * $_N; ++j)
            v += @_aims[i * $_TARGETS * $_N + j] * target[j];
        s->plan.f[i] = v;
        if (!@_fits(v, $_LARGEST))
            code = $_HELD;
    }
    for (int i = 0; i < $_ALL && code == $_OK; ++i)
        s->plan.base[i] = s->plan.f[i];
    return code;
}

static inline void @_start(@ *s)
{
    @_blank(&s->plan);
    (void)@_target(s, @_goal);
    for (int j = 0; j < $_M; ++j)
        s->u[j] = s->last[j] = @_begin[j];
    s->held = -1;
}

/* The first input of the best plan from the states y; a state that cannot be true goes on by the last plan. */
static inline int @_step(@ *s, const @_real *y, @_real *u)
{
    int code = $_OK;
    for (int i = 0; i < $_N; ++i)
        if (!@_fits(y[i], @_most[i]))
            code = $_HELD;
    for (int j = 0; j < $_M; ++j)
        if (!@_fits(s->u[j], $_LARGEST))
            s->u[j] = s->last[j];
    if (code == $_OK)
        code = @_solve(&s->plan, y, s->u);
    if (code != $_HELD)
        s->held = 0;
    else if (s->held >= 0 && s->held < $_STEPS - 1)
        ++s->held;
    for (int j = 0; j < $_M; ++j) {
        @_wide v = s->held >= 0 ? s->plan.u[s->held * $_M + j] : $_W(s->u[j]);
        s->u[j] = $_R(@_within(v, @_low[j], @_high[j]));
        u[j] = s->last[j] = s->u[j];
    }
    return code;
}
