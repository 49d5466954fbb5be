
/* The first input of the best plan; its limits are those about a set point that is near enough. */
static inline int @_policy(@_plan *p, const @_real *x, const @_real *xs, const @_real *us, const @_real *acted,
                            @_real *v)
{
    int code, moved = 0;
    @_real now[$_M];
    for (int j = 0; j < $_M + $_RESTS; ++j)
        moved = moved || !@_fits((j < $_M ? us[j] : xs[j - $_M]) - p->about[j], @_far[j]);
    for (int j = 0; j < $_M + $_RESTS && moved; ++j)
        p->about[j] = j < $_M ? us[j] : xs[j - $_M];
    for (int j = 0; j < $_M; ++j)
        now[j] = acted[j] - us[j] + p->about[j];
    code = @_solve(p, x, now);
    for (int j = 0; j < $_M; ++j)
        v[j] = $_R(p->u[j]);
    return code;
}
