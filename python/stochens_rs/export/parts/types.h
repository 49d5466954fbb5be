#ifdef $_FLOAT /* -D$_FLOAT: single precision */
typedef float @_real;
#define $_EPS FLT_EPSILON
#define $_HUGE FLT_MAX
#define $_LARGEST 1e18F
#define $_CAPPED 1e-5F
#define $_SQRT(v) sqrtf(v)
#else
typedef double @_real;
#define $_EPS DBL_EPSILON
#define $_HUGE DBL_MAX
#define $_LARGEST 1e150
#define $_CAPPED 1e-9
#define $_SQRT(v) sqrt(v)
#endif
#define $_R(v) ((@_real)(v))
#if $_WIDE /* plans that single precision does not resolve: double precision inside them in any case */
typedef double @_wide;
#define $_WIDE_EPS DBL_EPSILON
#else
typedef @_real @_wide;
#define $_WIDE_EPS $_EPS
#endif
#define $_W(v) ((@_wide)(v))
#define $_ABS(v) ((v) < $_R(0) ? -(v) : (v))

/* What @_step returns; in every case u holds numbers within the limits. @_target returns $_OK, or $_HELD where it was
   given nan, inf or what is too large: the target is then as before. */
enum {
    $_OK = 0,      /* a new input */
    $_HELD = 1,    /* what was read cannot be true (nan, inf, huge): the last safe input goes on */
    $_WAITS = 2,   /* the window is not full enough yet: the input held from the start */
    $_INEXACT = 3, /* the bounded search for the active limits ended early: a safe input, not the best */
    $_FILLED = 4   /* a new input, with a prediction in place of a reading that was missing or rejected */
};

#define @_fits(v, most) ((v) <= (most) && (v) >= -(most)) /* false for nan */
#define @_within(v, low, high) ((v) < (low) ? (low) : (v) > (high) ? (high) : (v))
