#ifndef $_H
#define $_H

#include <float.h>
#include <math.h>

#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "this controller tells nan from numbers: compile without -ffast-math and -ffinite-math-only"
#endif
