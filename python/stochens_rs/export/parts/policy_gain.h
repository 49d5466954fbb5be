
/* v = K x: the input about the set point. */
typedef struct {
    int none;
} @_plan;

static inline void @_blank(@_plan *p)
{
    p->none = 0;
}

static inline int @_policy(@_plan *p, const @_real *x, const @_real *xs, const @_real *us, const @_real *acted,
                            @_real *v)
{
    (void)p;
    (void)xs;
    (void)us;
    (void)acted;
    for (int j = 0; j < $_M; ++j) {
        v[j] = $_R(0);
        for (int i = 0; i < $_N; ++i)
            v[j] += @_K[j * $_N + i] * x[i];
    }
    return $_OK;
}
