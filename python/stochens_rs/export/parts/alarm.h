
#include <string.h>

/* The alarm: evidence that the plant is none of those that the loop was certified for. In double precision always. */
typedef struct {
    double level;       /* the evidence now: an alarm at @_alarm_threshold */
    double alarms;      /* how many there were */
    double calls, alarm; /* all calls, and the first one with an alarm since it was last set to 0; when the change
                            began cannot be told here: that needs the calls before it, see `Watch.onset` */
    double pairs, starts[3], since, idle, skipped;
    double x[$_ALARM_STATES], first[$_ALARM_P], z[$_ALARM_D];
    double evidence[$_ALARM_ALL], estimates[2 * $_ALARM_ROWS * $_ALARM_D];
    double sums[2][2 * $_ALARM_BETS * $_ALARM_SMALL], drift[2][$_ALARM_BETS * $_ALARM_SMALL * $_ALARM_ANY + 1];
    double squares[2][$_ALARM_BETS], sizes[2][$_ALARM_BETS];
    double e[$_ALARM_ROWS], wz[$_ALARM_ANY + 1], lengths[$_ALARM_PARTS + 1], along[$_ALARM_WAYS];
    double zeta[$_ALARM_D], mean[$_ALARM_ROWS];
} @_alarm;

/* What @_look returns. */
enum {
    $_QUIET = 0,
    $_ALARM = 1,    /* the plant has changed, or this is one of the false alarms that were asked for: see s->alarm */
    $_SKIPPED = 2,  /* no pair was complete: a reading or an input is missing */
    $_BLIND = 3     /* in the last 200 pairs only louder noise could have been seen */
};

static inline void @_alarm_start(@_alarm *s)
{
    memset(s, 0, sizeof *s);
}

static inline double @_dot(const double *a, const double *b, int n)
{
    double four[4] = {0.0, 0.0, 0.0, 0.0}, rest = 0.0;
    int i = 0;
    for (; i + 4 <= n; i += 4)
        for (int k = 0; k < 4; ++k)
            four[k] += a[i + k] * b[i + k];
    for (; i < n; ++i)
        rest += a[i] * b[i];
    return (four[0] + four[1]) + (four[2] + four[3]) + rest;
}

static inline double @_size(const double *a, int n)
{
    return sqrt(@_dot(a, a, n));
}

static inline int @_sound(double v, double most)
{
    return v <= most && v >= -most; /* false for nan */
}

static inline double @_least(double a, double b)
{
    return a < b ? a : b;
}

/* One step of filters in a row, of which the first is fed by `by`; without filters of a queue. */
static inline void @_moved(double *x, int size, const double *by, int width, int filters)
{
    for (int i = size - 1; i >= 0; --i) {
        double before = i < width ? by[i] : x[i - width];
        x[i] = filters ? @_alarm_pole[0] * x[i] + (1.0 - @_alarm_pole[0]) * before : before;
    }
}

static inline const double *@_due(const double *acting, const double *u)
{
    return $_ALARM_DELAY > 0 ? acting + ($_ALARM_COUNT + $_ALARM_DELAY - 1) * $_ALARM_M : u;
}

/* The factor of one step for the amplitude a. */
static inline double @_factor(double a, double x, double p, double v)
{
    double t = a * (x - p), f;
    if (!(a > 0.0) || !(v > 0.0))
        return 1.0;
    if ($_ALARM_LAW == 0) {
        double whole = 1.0 + (t < 0.0 ? -t : t) + 0.5 * t * t;
        f = (t >= 0.0 ? whole : 1.0 / whole) / (1.0 + 0.5 * a * a * v);
    } else if ($_ALARM_LAW == 2) {
        double deviation = sqrt(v), share = @_least(1.5 * a * deviation, 0.9);
        double off = (x - p) / (1.5 * deviation);
        f = 1.0 + share * (off < -1.0 ? -1.0 : off > 1.0 ? 1.0 : off);
    } else if ($_ALARM_LAW == 3 && x > p + sqrt(v) * (1.0 + 1e-9)) {
        f = 1e260;
    } else {
        f = exp(t - 0.5 * a * a * v);
    }
    return f >= 0.0 ? @_least(f, 1e260) : 0.0;
}

/* The factor of a bet on the energy r r. */
static inline double @_energy(double b, double r)
{
    if ($_ALARM_LAW == 1)
        return exp(0.5 * ((double)$_ALARM_ROWS * log1p(-b) + b * r * r));
    if ($_ALARM_LAW == 3)
        return r > 1.0 + 1e-9 ? 1e260 : 1.0 - b + b * r * r;
    return 1.0 - b + b * r * r / (double)$_ALARM_ROWS;
}

static inline void @_grow(@_alarm *s, int at, int block, double factor)
{
    double k = s->starts[block], add = $_ALARM_EVER ? 1.0 / (k * (k + 1.0)) : 1.0;
    factor = factor >= 0.0 ? @_least(factor, 1e260) : 0.0;
    s->evidence[at] = @_least(factor * (s->evidence[at] + add), 1e290);
}

static inline int @_singles(@_alarm *s)
{
    int active = 0;
    for (int b = 0; b < $_ALARM_BETS; ++b) {
        int column = (int)@_alarm_column[b], way = (int)@_alarm_direction[b];
        double g = column < $_ALARM_D ? s->z[column] : 1.0, x = g * s->along[way], v = g * g;
        double p = (g < 0.0 ? -g : g) * @_dot(@_alarm_spreads + way * $_ALARM_PARTS, s->lengths, $_ALARM_PARTS);
        s->squares[0][b] += @_least(p * p, 1e290);
        s->sizes[0][b] += v;
        for (int k = 0; k < $_ALARM_SHIFTS; ++k) {
            double amp = @_alarm_shifts[k] * @_alarm_unit[b], a = v > 0.0 && amp - p / v > 0.0 ? amp - p / v : 0.0;
            int at = b * $_ALARM_SMALL + k;
            active = active || a > 0.0;
            for (int side = 0; side < 2; ++side) {
                double by = side ? -x : x;
                @_grow(s, (b * $_ALARM_SHIFTS + k) * 2 + side, 0, @_factor(a, by, p, v));
                if (k < $_ALARM_SMALL && !$_ALARM_JOINT) {
                    double f = @_factor(amp, by, p, v);
                    s->sums[0][2 * at + side] += log(f > 1e-300 ? f : 1e-300);
                }
            }
            if (k < $_ALARM_SMALL && $_ALARM_JOINT) {
                double t = amp * x, even = @_least(0.5 * amp * amp * v, 1e290), slope = 1.0, size;
                t = t < -1e150 ? -1e150 : t > 1e150 ? 1e150 : t;
                size = t < 0.0 ? -t : t;
                if ($_ALARM_LAW == 0) {
                    double whole = 1.0 + size + 0.5 * t * t;
                    even = log1p(even);
                    slope = (1.0 + size) / whole;
                    t = (t < 0.0 ? -1.0 : 1.0) * log(whole);
                }
                s->sums[0][2 * at] += t;
                s->sums[0][2 * at + 1] += even;
                for (int i = 0; i < $_ALARM_ANY; ++i)
                    s->drift[0][at * $_ALARM_ANY + i] += slope * g * s->wz[i];
            }
        }
    }
    return active;
}

/* The end of a short block (0), which goes into the long one, or of a long one (1). */
static inline int @_ended(@_alarm *s, int which)
{
    int active = 0;
    for (int at = 0; at < $_ALARM_BETS * $_ALARM_SMALL; ++at) {
        int b = at / $_ALARM_SMALL, to = (int)@_alarm_starts[which + 1] + 2 * at;
        const double *spread = @_alarm_spreads + (int)@_alarm_direction[b] * $_ALARM_PARTS;
        double amp = @_alarm_shifts[at % $_ALARM_SMALL] * @_alarm_unit[b], p = 0.0;
        double one = s->sums[which][2 * at], other = s->sums[which][2 * at + 1];
        for (int k = 0; k < $_ALARM_PARTS; ++k) {
            int from = (int)@_alarm_begins[k], end = (int)@_alarm_begins[k + 1];
            p += spread[k] * @_size(s->drift[which] + at * $_ALARM_ANY + from, end - from);
        }
        p *= 1.0 + 1e-9;
        if ($_ALARM_JOINT) {
            double curved = $_ALARM_LAW == 0 ? 0.125 : 0.0;
            double lost = other + amp * p + curved * amp * amp * s->squares[which][b];
            other = -one - lost;
            one -= lost;
            active = active || amp * s->sizes[which][b] > 2.0 * p;
        }
        @_grow(s, to, which + 1, exp(one));
        @_grow(s, to + 1, which + 1, exp(other));
    }
    for (int i = 0; i < 2 * $_ALARM_BETS * $_ALARM_SMALL; ++i) {
        s->sums[1][i] = which ? 0.0 : s->sums[1][i] + s->sums[0][i];
        s->sums[0][i] = which ? s->sums[0][i] : 0.0;
    }
    for (int i = 0; i < $_ALARM_BETS * $_ALARM_SMALL * $_ALARM_ANY; ++i) {
        s->drift[1][i] = which ? 0.0 : s->drift[1][i] + s->drift[0][i];
        s->drift[0][i] = which ? s->drift[0][i] : 0.0;
    }
    for (int b = 0; b < $_ALARM_BETS; ++b) {
        s->squares[1][b] = which ? 0.0 : s->squares[1][b] + s->squares[0][b];
        s->sizes[1][b] = which ? 0.0 : s->sizes[1][b] + s->sizes[0][b];
        s->squares[0][b] = which ? s->squares[0][b] : 0.0;
        s->sizes[0][b] = which ? s->sizes[0][b] : 0.0;
    }
    return active;
}

/* Bets on running estimates of the difference from the model. */
static inline int @_learned(@_alarm *s)
{
    int active = 0;
    for (int i = 0; i < $_ALARM_D; ++i)
        s->zeta[i] = @_dot(@_alarm_scaled + i * $_ALARM_D, s->z, $_ALARM_D);
    for (int q = 0; q < 2; ++q) {
        double *rows = s->estimates + q * $_ALARM_ROWS * $_ALARM_D;
        double size, shift, factor = 1.0, gain;
        for (int i = 0; i < $_ALARM_ROWS; ++i)
            s->mean[i] = @_dot(rows + i * $_ALARM_D, s->zeta, $_ALARM_D);
        size = @_size(s->mean, $_ALARM_ROWS);
        shift = size - @_dot(@_alarm_norms, s->lengths, $_ALARM_PARTS);
        shift = shift > 5.0 ? 5.0 : shift;
        if (shift > 0.0) {
            double p = 0.0;
            for (int k = 0; k < $_ALARM_PARTS; ++k) {
                double square = 0.0, one;
                for (int i = 0; i < $_ALARM_ROWS; ++i) {
                    one = @_dot(@_alarm_reach + (k * $_ALARM_ROWS + i) * $_ALARM_ROWS, s->mean, $_ALARM_ROWS);
                    square += one * one;
                }
                p += (1.0 + 1e-9) * sqrt(square) * s->lengths[k];
            }
            size = 1.0 / size;
            factor = @_factor(shift, size * @_dot(s->mean, s->e, $_ALARM_ROWS), size * p, 1.0);
            active = 1;
        }
        @_grow(s, (int)@_alarm_starts[4] + q, 0, factor);
        gain = 1.0 / (@_alarm_learned[q] + @_dot(s->zeta, s->zeta, $_ALARM_D));
        for (int i = 0; i < $_ALARM_ROWS; ++i) {
            double rate = gain * (s->e[i] - s->mean[i]);
            for (int j = 0; j < $_ALARM_D; ++j)
                rows[i * $_ALARM_D + j] += (@_sound(rate, DBL_MAX) ? rate : 0.0) * s->zeta[j];
        }
    }
    return active;
}

/* e, W z and its lengths; 0 where z has a part in a direction that the data do not determine. */
static inline int @_residual(@_alarm *s, const double *y)
{
    int ok = 1;
    for (int k = 0; k < $_ALARM_LOST; ++k) {
        double sum = 0.0, size = 0.0;
        for (int j = 0; j < $_ALARM_D; ++j) {
            double v = @_alarm_lost[k * $_ALARM_D + j] * s->z[j];
            sum += v;
            size += v < 0.0 ? -v : v;
        }
        ok = ok && (sum < 0.0 ? -sum : sum) <= @_alarm_tolerance[k] * DBL_EPSILON * size;
    }
    for (int i = 0; i < $_ALARM_ANY; ++i)
        s->wz[i] = @_dot(@_alarm_white + i * $_ALARM_D, s->z, $_ALARM_D);
    for (int k = 0; k < $_ALARM_PARTS; ++k) {
        int from = (int)@_alarm_begins[k], end = (int)@_alarm_begins[k + 1];
        s->lengths[k] = (1.0 + 1e-9) * @_size(s->wz + from, end - from);
        ok = ok && @_sound(s->lengths[k], 1e140);
    }
    for (int i = 0; i < $_ALARM_ROWS; ++i)
        s->e[i] = y[(int)@_alarm_rows[i]] - @_dot(@_alarm_centre + i * $_ALARM_D, s->z, $_ALARM_D);
    for (int i = $_ALARM_ROWS - 1; i >= 0; --i) {
        s->e[i] = @_dot(@_alarm_back + i * $_ALARM_ROWS, s->e, i + 1);
        ok = ok && @_sound(s->e[i], 1e140);
    }
    for (int j = 0; j < $_ALARM_D; ++j)
        ok = ok && @_sound(s->z[j], 1e140);
    return ok;
}

/* All bets of a pair. */
static inline void @_paired(@_alarm *s, const double *y)
{
    int active, ends[5] = {1, 0, 0, 1, 1};
    const int blocks[2] = {$_ALARM_SHORT, $_ALARM_LONG};
    double r, sum = 0.0;
    if (!@_residual(s, y))
        return;
    s->skipped = 0.0;
    for (int i = 0; i < $_ALARM_WAYS; ++i)
        s->along[i] = @_dot(@_alarm_directions + i * $_ALARM_ROWS, s->e, $_ALARM_ROWS);
    s->pairs += 1.0;
    s->starts[0] += 1.0;
    active = @_singles(s);
    active = @_learned(s) || active;
    for (int k = 0; k < 2; ++k)
        if ((unsigned long long)s->pairs % (unsigned long long)blocks[k] == 0) {
            s->starts[k + 1] += 1.0;
            active = @_ended(s, k) || active;
            ends[k + 1] = 1;
        }
    r = @_size(s->e, $_ALARM_ROWS) - @_dot(@_alarm_norms, s->lengths, $_ALARM_PARTS);
    for (int k = 0; k < $_ALARM_SHARES; ++k)
        @_grow(s, (int)@_alarm_starts[3] + k, 0, @_energy(@_alarm_shares[k], r > 0.0 ? r : 0.0));
    s->idle = active ? 0.0 : s->idle + 1.0;
    for (int part = 0, at = 0; part < 5; ++part)
        for (; at < (int)@_alarm_starts[part + 1]; ++at)
            if (ends[part])
                sum += @_alarm_weights[part] * s->evidence[at];
    s->level = sum;
    if (sum >= @_alarm_threshold[0] * (1.0 + 1e-9)) {
        s->alarms += 1.0;
        s->alarm = s->alarm > 0.0 ? s->alarm : s->calls;
        s->pairs = 0.0;
        memset(s->evidence, 0, sizeof s->evidence);
        memset(s->sums, 0, sizeof s->sums);
        memset(s->drift, 0, sizeof s->drift);
        memset(s->squares, 0, sizeof s->squares);
        memset(s->sizes, 0, sizeof s->sizes);
    }
}

/* One call, as each of the controller: the readings now, nan where one is missing, and the input that acted since the last call. */
static inline int @_look(@_alarm *s, const @_real *y, const @_real *acted)
{
    double now[$_ALARM_P], by[$_ALARM_M];
    double *past = s->x, *acting = s->x + $_ALARM_COUNT * $_ALARM_P;
    const int filtered = $_ALARM_FILTERS * $_ALARM_COUNT * $_ALARM_M;
    int read = 1, known = 1;
    for (int i = 0; i < $_ALARM_P; ++i) {
        now[i] = (double)y[i];
        read = read && @_sound(now[i], DBL_MAX);
    }
    for (int j = 0; j < $_ALARM_M; ++j) {
        by[j] = (double)acted[j];
        known = known && @_sound(by[j], DBL_MAX);
    }
    s->calls += 1.0;
    s->skipped += 1.0;
    if (s->since > 0.0 && read && known) {
        double *z = s->z + $_ALARM_COUNT * $_ALARM_P;
        if (!(s->since > 1.0)) {
            for (int i = 0; i < $_ALARM_COUNT * $_ALARM_P; ++i)
                past[i] = s->first[i % $_ALARM_P];
            for (int i = 0; i < $_ALARM_STATES - $_ALARM_COUNT * $_ALARM_P; ++i)
                acting[i] = by[i % $_ALARM_M];
        }
        memcpy(s->z, past, sizeof(double) * $_ALARM_COUNT * $_ALARM_P);
        if ($_ALARM_FILTERS) {
            for (int i = 0; i < filtered; ++i)
                z[i] = acting[i];
            @_moved(z, filtered, @_due(acting, by), $_ALARM_M, 1);
        } else {
            for (int i = 0; i < $_ALARM_COUNT * $_ALARM_M; ++i) {
                int at = i + $_ALARM_DELAY * $_ALARM_M;
                z[i] = at < $_ALARM_M ? by[at] : acting[at - $_ALARM_M];
            }
        }
        if ($_ALARM_INTERCEPT)
            z[$_ALARM_COUNT * $_ALARM_M] = 1.0;
        if (s->since > (double)$_ALARM_FILL)
            @_paired(s, now);
        @_moved(past, $_ALARM_COUNT * $_ALARM_P, now, $_ALARM_P, $_ALARM_FILTERS);
        if ($_ALARM_FILTERS)
            @_moved(acting, filtered, @_due(acting, by), $_ALARM_M, 1);
        @_moved(acting + filtered, $_ALARM_STATES - $_ALARM_COUNT * $_ALARM_P - filtered, by, $_ALARM_M, 0);
        s->since += 1.0;
    } else if (read) {
        memcpy(s->first, now, sizeof now);
        s->since = 1.0;
    } else {
        s->since = 0.0;
    }
    return s->alarm > 0.0 ? $_ALARM : s->skipped > 0.0 ? $_SKIPPED : s->idle >= 200.0 ? $_BLIND : $_QUIET;
}
