
/* The state of the loop. */
typedef struct {
    @_real u[$_M]; /* the input returned last */
} @;

static inline void @_start(@ *s)
{
    for (int j = 0; j < $_M; ++j)
        s->u[j] = $_R(0);
}

/* u = K y for the states y; a state that cannot be true holds the last input. */
static inline int @_step(@ *s, const @_real *y, @_real *u)
{
    @_real v[$_M];
    int ok = 1;
    for (int i = 0; i < $_N; ++i)
        ok = ok && @_fits(y[i], @_most[i]);
    for (int j = 0; j < $_M && ok; ++j) {
        v[j] = $_R(0);
        for (int i = 0; i < $_N; ++i)
            v[j] += @_K[j * $_N + i] * y[i];
        ok = @_fits(v[j], $_HUGE);
    }
    for (int j = 0; j < $_M; ++j) {
        if (ok)
            s->u[j] = v[j];
        u[j] = s->u[j];
    }
    return ok ? $_OK : $_HELD;
}
