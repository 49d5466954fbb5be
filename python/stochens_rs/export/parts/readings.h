
/* A window of readings and inputs, and what is known of it. */
typedef struct {
    @_real x[$_N];
    @_real cov[$_N * $_N]; /* of its error, where it is not known */
    @_real excess;         /* what that adds to the variance of the next readings, in units of the noise */
    int known, since, missed, calls, first;
} @_window;

/* The state of the loop. */
typedef struct {
    @_window now, next;
    @_window others[2], spare[2]; /* with all readings that were rejected, and with all but the first */
    @_real u[$_M];           /* the input returned last */
    @_real applied[$_M];     /* what acts until the next call: write here what was applied if it is not u */
    @_real target[$_P];      /* where the outputs are to go; those that were free stay free */
    @_real slope[$_P];       /* what that changes by until the next call */
    @_real goal[$_P];        /* the last target that can be */
    @_real bias[$_P];        /* what is learned of a constant that is added to each reading */
    @_real joint[($_N + $_P) * ($_N + $_P)], rows[$_P * ($_N + $_P)], step[$_N * ($_N + $_P)];
    @_real row, alike, off[$_P]; /* rejected in a row, off by the same, and by what: of a change of the plant */
    int full, raised, doubted, started; /* raised: how many others there are */
    @_plan plan;
} @;

static inline void @_start(@ *s)
{
    @_blank(&s->plan);
    for (int j = 0; j < $_M; ++j)
        s->u[j] = s->applied[j] = @_begin[j];
    for (int i = 0; i < $_P; ++i) {
        s->target[i] = s->goal[i] = @_first_target[i];
        s->slope[i] = s->bias[i] = $_R(0);
    }
    s->row = s->alike = $_R(0);
    s->full = s->raised = s->doubted = s->started = 0;
}

/* Where the outputs are to go: $_TARGETS rows, at the next call, and at the one behind it, where it then stays. */
static inline int @_target(@ *s, const @_real *target)
{
    for (int i = 0; i < $_TARGETS * $_P; ++i)
        if (!@_fits(target[i], @_most[i % $_P]))
            return $_HELD;
    for (int i = 0; i < $_P; ++i) {
        s->target[i] = target[i];
        s->slope[i] = target[($_TARGETS - 1) * $_P + i] - target[i];
    }
    return $_OK;
}

/* One step of filters in a row, of which the first is fed by `by`. */
static inline void @_shift(@_real *x, int size, const @_real *by, int width)
{
    for (int i = size - 1; i >= 0; --i) {
        @_real before = i < width ? by[i] : x[i - width];
        x[i] = $_FILTERS ? @_pole[0] * x[i] + ($_R(1) - @_pole[0]) * before : before;
    }
}

static inline const @_real *@_arriving(const @_real *x, const @_real *u)
{
    return $_DELAY > 0 ? x + $_COUNT * ($_P + $_M) + ($_DELAY - 1) * $_M : u;
}

/* z of the window and the input. */
static inline void @_regressors(const @_real *x, const @_real *u, @_real *z)
{
    for (int i = 0; i < $_COUNT * $_P; ++i)
        z[i] = x[i];
    z += $_COUNT * $_P;
    if ($_FILTERS) {
        for (int i = 0; i < $_COUNT * $_M; ++i)
            z[i] = x[$_COUNT * $_P + i];
        @_shift(z, $_COUNT * $_M, @_arriving(x, u), $_M);
    } else {
        for (int i = 0; i < $_COUNT * $_M; ++i) {
            int at = i + $_DELAY * $_M;
            z[i] = at < $_M ? u[at] : x[$_COUNT * $_P + at - $_M];
        }
    }
    if ($_INTERCEPT)
        z[$_COUNT * $_M] = $_R(1);
}

static inline void @_advance(@_real *x, const @_real *y, const @_real *u)
{
    @_real *acting = x + $_COUNT * $_P;
    @_shift(x, $_COUNT * $_P, y, $_P);
    if ($_FILTERS) {
        @_shift(acting, $_COUNT * $_M, @_arriving(x, u), $_M);
        acting += $_COUNT * $_M;
    }
    for (int i = $_N - (int)(acting - x) - 1; i >= 0; --i)
        acting[i] = i < $_M ? u[i] : acting[i - $_M];
}

/* L L' = a in place, of the first k rows and columns of a (p wide); 0 if it has none. */
static inline int @_cholesky(@_real *a, int k)
{
    for (int i = 0; i < k; ++i)
        for (int j = 0; j <= i; ++j) {
            @_real v = a[i * $_P + j];
            for (int q = 0; q < j; ++q)
                v -= a[i * $_P + q] * a[j * $_P + q];
            if (i > j)
                a[i * $_P + j] = v / a[j * $_P + j];
            else if (v > $_R(0) && @_fits(v, $_HUGE))
                a[i * $_P + i] = $_SQRT(v);
            else
                return 0;
        }
    return 1;
}

/* The largest eigenvalue of a symmetric matrix of k rows (p wide), by Jacobi's rotations. */
static inline @_real @_largest(@_real *a, int k)
{
    @_real most = $_R(0);
    for (int sweep = 0; sweep < 30; ++sweep) {
        @_real off = $_R(0), all = $_R(0);
        for (int i = 0; i < k; ++i)
            for (int j = 0; j < k; ++j) {
                @_real v = a[i * $_P + j] < $_R(0) ? -a[i * $_P + j] : a[i * $_P + j];
                all += v;
                off += i == j ? $_R(0) : v;
            }
        if (!@_fits(all, $_LARGEST))
            return $_HUGE;
        if (!(off > $_EPS * $_EPS * all))
            break;
        for (int i = 0; i < k; ++i)
            for (int j = 0; j < i; ++j) {
                @_real e = a[i * $_P + j], d = a[j * $_P + j] - a[i * $_P + i], t, c, h;
                if (!(e > $_R(0) || e < $_R(0)))
                    continue;
                h = $_SQRT(d * d + $_R(4) * e * e);
                t = $_R(2) * e / (d < $_R(0) ? d - h : d + h);
                c = $_R(1) / $_SQRT($_R(1) + t * t);
                for (int q = 0; q < k; ++q) {
                    @_real x = a[i * $_P + q], y = a[j * $_P + q];
                    a[i * $_P + q] = c * (x - t * y);
                    a[j * $_P + q] = c * (y + t * x);
                }
                for (int q = 0; q < k; ++q) {
                    @_real x = a[q * $_P + i], y = a[q * $_P + j];
                    a[q * $_P + i] = c * (x - t * y);
                    a[q * $_P + j] = c * (y + t * x);
                }
            }
    }
    for (int i = 0; i < k; ++i)
        most = a[i * $_P + i] > most ? a[i * $_P + i] : most;
    return most;
}

/* a x = b of k rows, b with `columns`; rows with the largest pivots first. 0 if it is singular. */
static inline int @_equations(@_real *a, int k, int wide, @_real *b, int columns)
{
    for (int i = 0; i < k; ++i) {
        int at = i;
        for (int r = i + 1; r < k; ++r) {
            @_real v = a[r * wide + i], w = a[at * wide + i];
            at = (v < $_R(0) ? -v : v) > (w < $_R(0) ? -w : w) ? r : at;
        }
        if (!(a[at * wide + i] > $_R(0) || a[at * wide + i] < $_R(0)))
            return 0;
        for (int j = 0; j < k && at != i; ++j) {
            @_real v = a[i * wide + j];
            a[i * wide + j] = a[at * wide + j];
            a[at * wide + j] = v;
        }
        for (int j = 0; j < columns && at != i; ++j) {
            @_real v = b[i * columns + j];
            b[i * columns + j] = b[at * columns + j];
            b[at * columns + j] = v;
        }
        for (int r = i + 1; r < k; ++r) {
            @_real by = a[r * wide + i] / a[i * wide + i];
            for (int j = i; j < k; ++j)
                a[r * wide + j] -= by * a[i * wide + j];
            for (int j = 0; j < columns; ++j)
                b[r * columns + j] -= by * b[i * columns + j];
        }
    }
    for (int i = k - 1; i >= 0; --i)
        for (int j = 0; j < columns; ++j) {
            @_real v = b[i * columns + j];
            for (int r = i + 1; r < k; ++r)
                v -= a[i * wide + r] * b[r * columns + j];
            b[i * columns + j] = v / a[i * wide + i];
        }
    return 1;
}

/* C cov C' of a window that is not known; 0 else. */
static inline void @_unknown(const @_window *w, @_real *to)
{
    for (int i = 0; i < $_P * $_P; ++i)
        to[i] = $_R(0);
    for (int i = 0; i < $_P && !w->known; ++i)
        for (int a = 0; a < $_N; ++a) {
            @_real v = $_R(0);
            for (int b = 0; b < $_N; ++b)
                v += @_C[i * $_N + b] * w->cov[b * $_N + a];
            for (int j = 0; j < $_P; ++j)
                to[i * $_P + j] += v * @_C[j * $_N + a];
        }
}

/* What is counted of a window, and how sure it is. */
static inline void @_counted(@_window *w, const int *seen)
{
    int all = 1, any = 0;
    @_real by[$_N], added[$_P * $_P];
    for (int i = 0; i < $_P; ++i) {
        all = all && seen[i];
        any = any || seen[i];
    }
    w->calls += w->calls <= $_FILL + 1;
    w->since = all ? w->since + (w->since <= $_FILL) : 0;
    w->missed = any ? 0 : w->missed + (w->missed <= $_MISSING);
    if (w->since > $_FILL)
        w->known = 1;
    w->excess = $_R(0);
    if (w->known)
        return;
    for (int i = 0; i < $_P; ++i) {
        for (int a = 0; a < $_N; ++a) {
            by[a] = $_R(0);
            for (int b = 0; b < $_N; ++b)
                by[a] += @_seen_by[i * $_N + b] * w->cov[b * $_N + a];
        }
        for (int j = 0; j < $_P; ++j) {
            added[i * $_P + j] = $_R(0);
            for (int a = 0; a < $_N; ++a)
                added[i * $_P + j] += by[a] * @_seen_by[j * $_N + a];
        }
    }
    w->excess = @_largest(added, $_P);
}

/* The window at a first reading: all before it is taken to be the same. */
static inline void @_begun(@_window *w, const @_real *y, const @_real *u, const int *seen)
{
    for (int i = 0; i < $_N; ++i) {
        int of = i - $_COUNT * $_P;
        w->x[i] = of >= 0 ? u[of % $_M] : seen[i % $_P] ? y[i % $_P] : @_mean[i % $_P];
        for (int j = 0; j < $_N; ++j)
            w->cov[i * $_N + j] = $_R(0);
        if ($_FILTERS || i >= $_P || !seen[i % $_P])
            w->cov[i * $_N + i] = @_apart[i] * @_apart[i];
    }
    w->known = w->since = w->missed = w->calls = 0;
    w->first = $_FILL + 1;
    @_counted(w, seen);
}

/* The window one step later (Kalman's filter, in which a reading that came has no error). */
static inline void @_advanced(@ *s, const @_window *w, @_window *to, const @_real *y, const @_real *u, const int *seen,
                              const @_real *predicted)
{
    enum { wide = $_N + $_P };
    @_real filled[$_P] = {0}, own[$_P * $_P] = {0}, off[$_N + $_P] = {0}, left[$_P] = {0};
    int came[$_P] = {0}, count = 0;
    *to = *w;
    for (int i = 0; i < $_P; ++i) {
        filled[i] = y[i];
        if (seen[i])
            came[count++] = i;
    }
    if (w->known && count == $_P) {
        @_advance(to->x, y, u);
        @_counted(to, seen);
        return;
    }
    @_unknown(w, own);
    for (int i = 0; i < wide; ++i) {
        off[i] = $_R(0);
        for (int j = 0; j < wide; ++j) {
            @_real v = $_R(0);
            if (i < $_N && j < $_N)
                v = w->known ? $_R(0) : w->cov[i * $_N + j];
            else if (i >= $_N && j >= $_N)
                v = own[(i - $_N) * $_P + j - $_N] + @_noise[(i - $_N) * $_P + j - $_N];
            else
                for (int b = 0; b < $_N && !w->known; ++b)
                    v += i < $_N ? @_C[(j - $_N) * $_N + b] * w->cov[b * $_N + i]
                                 : @_C[(i - $_N) * $_N + b] * w->cov[b * $_N + j];
            s->joint[i * wide + j] = v;
        }
    }
    for (int i = 0; i < count; ++i) {
        for (int j = 0; j < count; ++j)
            own[i * $_P + j] = s->joint[($_N + came[i]) * wide + $_N + came[j]];
        for (int j = 0; j < wide; ++j)
            s->rows[i * wide + j] = s->joint[($_N + came[i]) * wide + j];
        left[i] = y[came[i]] - predicted[came[i]];
    }
    if (count > 0 && @_equations(own, count, $_P, s->rows, wide)) {
        for (int i = 0; i < wide; ++i)
            for (int k = 0; k < count; ++k)
                off[i] += s->rows[k * wide + i] * left[k];
        for (int k = 0; k < count; ++k) /* the rows of joint that came stay as they are till the end */
            for (int i = 0; i < wide; ++i) {
                int skip = 0;
                for (int q = 0; q < count; ++q)
                    skip = skip || i == $_N + came[q];
                for (int j = 0; j < wide && !skip; ++j)
                    s->joint[i * wide + j] -= s->rows[k * wide + i] * s->joint[($_N + came[k]) * wide + j];
            }
        for (int k = 0; k < count; ++k)
            for (int i = 0; i < wide; ++i)
                s->joint[($_N + came[k]) * wide + i] = s->joint[i * wide + $_N + came[k]] = $_R(0);
    }
    for (int i = 0; i < $_N; ++i)
        for (int j = 0; j < wide; ++j) {
            @_real v = $_R(0);
            for (int q = 0; q < wide; ++q)
                v += @_ahead[i * wide + q] * s->joint[q * wide + j];
            s->step[i * wide + j] = v;
        }
    for (int i = 0; i < $_N; ++i)
        for (int j = 0; j < $_N; ++j) {
            @_real v = $_R(0);
            for (int q = 0; q < wide; ++q)
                v += s->step[i * wide + q] * @_ahead[j * wide + q];
            to->cov[i * $_N + j] = v;
        }
    for (int i = 0; i < $_N; ++i)
        for (int j = 0; j < i; ++j)
            to->cov[i * $_N + j] = to->cov[j * $_N + i] = (to->cov[i * $_N + j] + to->cov[j * $_N + i]) / $_R(2);
    to->known = 0;
    for (int i = 0; i < $_P; ++i)
        if (!seen[i])
            filled[i] = predicted[i] + off[$_N + i];
    for (int i = 0; i < $_N; ++i)
        to->x[i] += off[i];
    @_advance(to->x, filled, u);
    @_counted(to, seen);
}

/* (||T off|| - sum ||T D|| ||W z||) / q of the readings that came; above 1 it rejects. T T' = cov^-1. `one`: of the
   system of the model alone, ||T off|| / q. */
static inline @_real @_excess(const @_real *off, const @_real *z, const int *seen, const @_real *more, int one)
{
    @_real root[$_P * $_P] = {0}, half[$_P * $_P] = {0}, white[$_P] = {0}, far = $_R(0), room = $_R(0);
    int came[$_P] = {0}, k = 0;
    for (int i = 0; i < $_P; ++i)
        if (seen[i])
            came[k++] = i;
    for (int i = 0; i < k; ++i)
        for (int j = 0; j < k; ++j)
            root[i * $_P + j] = @_gate_noise[came[i] * $_P + came[j]] + more[came[i] * $_P + came[j]];
    if (!@_cholesky(root, k))
        return $_R(0);
    for (int i = 0; i < k; ++i) {
        @_real v = off[came[i]];
        for (int j = 0; j < i; ++j)
            v -= root[i * $_P + j] * white[j];
        white[i] = v / root[i * $_P + i];
        far += white[i] * white[i];
    }
    for (int part = 0; part < $_PARTS && !one; ++part) {
        @_real length = $_R(0);
        for (int r = 0; r < $_LOST; ++r) { /* of what the data do not determine nothing is too far */
            @_real v = $_R(0), size = $_R(0);
            for (int j = 0; j < $_D; ++j) {
                @_real by = @_lost[(part * $_LOST + r) * $_D + j] * z[j];
                v += by;
                size += by < $_R(0) ? -by : by;
            }
            if (!@_fits(v, @_tolerance[part] * $_EPS * size))
                return $_R(0);
        }
        for (int r = 0; r < $_D; ++r) {
            @_real v = $_R(0);
            for (int j = 0; j < $_D; ++j)
                v += @_white[(part * $_D + r) * $_D + j] * z[j];
            length += v * v;
        }
        /* half = L^-1 D D', then L^-1 of its transpose */
        for (int turn = 0; turn < 2; ++turn)
            for (int j = 0; j < k; ++j)
                for (int i = 0; i < k; ++i) {
                    @_real v = turn ? half[j * $_P + i] : @_shape[(part * $_P + came[i]) * $_P + came[j]];
                    for (int q = 0; q < i; ++q)
                        v -= root[i * $_P + q] * (turn ? half[j * $_P + q] : half[q * $_P + j]);
                    half[turn ? j * $_P + i : i * $_P + j] = v / root[i * $_P + i];
                }
        room += $_SQRT(@_largest(half, k)) * $_SQRT(length);
    }
    return ($_SQRT(far) - room) / @_quantile[k];
}

/* How far off readings are behind the window `of`, with the bias or without it. */
static inline @_real @_off(const @ *s, const @_window *of, const @_real *y, const @_real *z, const int *seen, int one)
{
    @_real off[$_P], more[$_P * $_P], found, other;
    int any = 0, shifted = 0;
    for (int i = 0; i < $_P; ++i) {
        off[i] = y[i];
        for (int j = 0; j < $_D; ++j)
            off[i] -= @_gate_theta[i * $_D + j] * z[j];
        any = any || seen[i];
        shifted = shifted || $_ABS(s->bias[i]) > $_CAPPED * $_SQRT(@_noise[i * $_P + i]); /* less is rounding */
    }
    if (!$_GATE || !any)
        return $_R(0);
    @_unknown(of, more);
    found = @_excess(off, z, seen, more, one);
    if (found > $_R(1) && shifted) {
        for (int i = 0; i < $_P * $_P; ++i)
            more[i] += @_spread[i];
        for (int i = 0; i < $_P; ++i)
            off[i] -= s->bias[i];
        other = @_excess(off, z, seen, more, one);
        return other < found ? other : found;
    }
    return found;
}

/* The largest share of a bias that the limits of all inputs allow. */
static inline @_real @_share(const @_real *bias, const @_real *us)
{
    @_real share = $_R(1);
    for (int j = 0; j < $_M; ++j) {
        @_real wanted = $_R(0), there, size;
        for (int i = 0; i < $_P; ++i)
            wanted += @_us_of_bias[j * $_P + i] * bias[i];
        there = @_within(us[j] + wanted, @_floor[j], @_ceiling[j]) - us[j];
        size = $_ABS(wanted) > $_ABS(us[j]) ? $_ABS(wanted) : $_ABS(us[j]);
        if ($_ABS(wanted - there) > $_CAPPED * size && there / wanted < share)
            share = there / wanted;
    }
    return share > $_R(0) ? share : $_R(0);
}

/* The nearest bias that inputs within the limits can take off at the set point. */
static inline void @_project(@_real *bias, const @_real *us)
{
    int held[$_M] = {0}, count = 0;
    @_real value[$_M] = {0}, across[$_P * $_M] = {0}, a[$_M * $_M] = {0}, b[$_M] = {0};
    for (int round = 0; round < $_M; ++round) {
        int before = count, fine = 1;
        for (int j = 0; j < $_M; ++j) {
            @_real wanted = $_R(0), v, w, size;
            int there = 0;
            for (int i = 0; i < $_P; ++i)
                wanted += @_us_of_bias[j * $_P + i] * bias[i];
            v = us[j] + wanted;
            size = $_ABS(wanted) > $_ABS(us[j]) ? $_ABS(wanted) : $_ABS(us[j]);
            for (int k = 0; k < before; ++k)
                there = there || held[k] == j;
            w = @_within(v, @_floor[j], @_ceiling[j]);
            if (!there && $_ABS(v - w) > $_CAPPED * size) {
                value[count] = w - us[j];
                held[count++] = j;
            }
        }
        if (count == before || count > $_P)
            return;
        for (int k = 0; k < count; ++k)
            for (int i = 0; i < $_P; ++i) {
                across[i * $_M + k] = $_R(0);
                for (int q = 0; q < $_P; ++q)
                    across[i * $_M + k] += @_noise[i * $_P + q] * @_us_of_bias[held[k] * $_P + q];
            }
        for (int k = 0; k < count; ++k) {
            b[k] = value[k];
            for (int i = 0; i < $_P; ++i)
                b[k] -= @_us_of_bias[held[k] * $_P + i] * bias[i];
            for (int q = 0; q < count; ++q) {
                a[k * $_M + q] = $_R(0);
                for (int i = 0; i < $_P; ++i)
                    a[k * $_M + q] += @_us_of_bias[held[k] * $_P + i] * across[i * $_M + q];
            }
        }
        fine = @_equations(a, count, $_M, b, 1);
        for (int k = 0; k < count; ++k)
            fine = fine && @_fits(b[k], $_LARGEST);
        for (int i = 0; i < $_P && fine; ++i)
            for (int k = 0; k < count; ++k)
                bias[i] += across[i * $_M + k] * b[k];
    }
}

/* Where the limits are more than a bias can meet, the largest share of it that all of them allow. */
static inline void @_capped(@_real *bias, const @_real *us)
{
    @_real asked[$_P], share;
    for (int i = 0; i < $_P; ++i)
        asked[i] = bias[i];
    @_project(bias, us);
    if (@_share(bias, us) < $_R(1)) {
        share = @_share(asked, us);
        for (int i = 0; i < $_P; ++i)
            bias[i] = share * asked[i];
    }
}

/* y = Theta z + bias */
static inline void @_predict(const @_real *z, const @_real *bias, @_real *y)
{
    for (int i = 0; i < $_P; ++i) {
        y[i] = $_R(0);
        for (int j = 0; j < $_D; ++j)
            y[i] += @_theta[i * $_D + j] * z[j];
        y[i] += bias[i];
    }
}

/* One more reading is rejected; off by the same as the last one: within half of the larger one. */
static inline void @_reject(@ *s, const @_real *y, const @_real *predicted, const int *seen)
{
    @_real apart = $_R(0), before = $_R(0), size = $_R(0);
    for (int i = 0; i < $_P; ++i) {
        @_real v = seen[i] ? (y[i] - predicted[i]) / $_SQRT(@_noise[i * $_P + i]) : $_R(0), by;
        v = @_fits(v, $_LARGEST) ? v : $_R(0);
        by = v - s->off[i];
        apart += by * by;
        before += s->off[i] * s->off[i];
        size += v * v;
        s->off[i] = v;
    }
    s->row += s->row < $_R(4) ? $_R(1) : $_R(0);
    if (s->doubted && $_R(4) * apart <= (before > size ? before : size))
        s->alike = s->alike < $_R(15) ? s->alike + $_R(3) : $_R(18);
    else
        s->alike = $_R(3);
    s->doubted = 1;
}

/* The window `with` one step later, with the readings that were rejected, as spare[k]; how many there are then. */
static inline int @_follow(@ *s, const @_window *with, int k, const @_real *y, const @_real *acted, const int *seen,
                           const @_real *bias)
{
    @_real z[$_D], predicted[$_P];
    @_regressors(with->x, acted, z);
    @_predict(z, bias, predicted);
    @_advanced(s, with, &s->spare[k], y, acted, seen, predicted);
    return k + 1;
}

/* The input from the readings y now; nan where one is missing. */
static inline int @_step(@ *s, const @_real *y, @_real *u)
{
    int seen[$_P], none[$_P], known = 1, complete = 1, lost = 0, runs = 0, code = $_OK, raised = 0, begins = !s->full;
    @_real read[$_P], acted[$_M], us[$_M], goal[$_M], bias[$_P], z[$_D], predicted[$_P], x[$_N], xs[$_N];
    @_real slope[$_P], sum = $_R(0);
    @_real v[$_M] = {0};
    for (int i = 0; i < $_P; ++i) {
        seen[i] = @_fits(y[i], @_most[i]);
        none[i] = 0;
        complete = complete && seen[i];
        read[i] = seen[i] ? y[i] : $_R(0);
        bias[i] = s->bias[i];
        if (@_fits(s->target[i], @_most[i]))
            s->goal[i] = s->target[i];
        slope[i] = @_fits(s->slope[i], @_most[i]) ? s->slope[i] : $_R(0);
    }
    for (int j = 0; j < $_M; ++j)
        known = known && @_fits(s->applied[j], @_most[$_P + j]);
    for (int j = 0; j < $_M; ++j)
        acted[j] = known ? s->applied[j] : s->u[j];
    for (int j = 0; j < $_M; ++j) {
        goal[j] = @_us[j];
        for (int i = 0; i < $_P; ++i)
            goal[j] += @_us_of_target[j * $_P + i] * (s->goal[i] - @_first_target[i]);
        us[j] = @_within(goal[j], @_floor[j], @_ceiling[j]);
    }
    if (s->full) {
        const @_window *from = &s->now;
        const int *came = seen;
        int change = 0;
        @_real off;
        @_regressors(s->now.x, acted, z);
        off = @_off(s, &s->now, read, z, seen, 0);
        begins = off > $_R(1) && s->now.calls == 1 && !s->now.known;
        if (off > $_R(1)) {
            change = s->row >= $_R(3) || s->alike >= $_R(9); /* alike: in thirds */
            @_predict(z, bias, predicted);
            @_reject(s, read, predicted, seen);
            if (change) { /* taken for true, behind the window that predicts them: another one if half as far off */
                @_real least = $_HUGE;
                for (int k = 0; k <= s->raised; ++k) {
                    const @_window *with = k < s->raised ? &s->others[k] : &s->now;
                    @_real other[$_D];
                    @_regressors(with->x, acted, other);
                    off = @_off(s, with, read, other, seen, 1);
                    if (off < least / $_R(2)) {
                        from = with;
                        least = off;
                        for (int j = 0; j < $_D; ++j)
                            z[j] = other[j];
                    }
                }
                raised = 1;
            } else {
                came = none;
                complete = 0;
                raised = @_follow(s, s->raised > 0 ? &s->others[0] : &s->now, 0, read, acted, seen, bias);
                if (s->raised > 0)
                    raised = @_follow(s, s->raised > 1 ? &s->others[1] : &s->now, 1, read, acted, seen, bias);
            }
        } else {
            s->row = $_R(0);
            s->alike = s->alike > $_R(1) ? s->alike - $_R(1) : $_R(0);
            for (int k = 0; k < s->raised && s->alike > $_R(0); ++k)
                raised = @_follow(s, &s->others[k], k, read, acted, seen, bias);
        }
        @_predict(z, bias, predicted);
        for (int i = 0; i < $_P && s->started; ++i)
            for (int q = 0; q < $_P; ++q)
                if (came[q])
                    bias[i] += @_learn[i * $_P + q] * (read[q] - predicted[q]);
        if ($_GATE)
            @_capped(bias, us);
        @_advanced(s, from, &s->next, read, acted, came, predicted);
        s->now = s->next;
        if (change)
            s->spare[0] = s->next;
        for (int k = 0; k < raised; ++k)
            s->others[k] = s->spare[k];
    }
    if (begins) { /* of two readings that do not agree the second is kept: no others say which is false */
        @_begun(&s->now, read, acted, seen);
        s->row = s->alike = $_R(0);
        s->doubted = raised = 0;
    }
    s->full = 1;
    s->raised = raised;
    for (int i = 0; i < $_N; ++i)
        sum += s->now.x[i];
    for (int i = 0; i < $_P; ++i)
        sum += bias[i];
    lost = !(@_fits(sum, $_HUGE) && s->now.excess < $_R(1e12));
    if (!lost)
        runs = (s->now.known || (s->now.excess <= $_R(9) && (s->started || s->now.calls >= s->now.first))) &&
               s->now.missed <= $_MISSING;
    if (runs) { /* u = us + v, v of the window about the set point */
        for (int j = 0; j < $_M; ++j) {
            us[j] = goal[j];
            for (int i = 0; i < $_P; ++i)
                us[j] += @_us_of_bias[j * $_P + i] * bias[i] + @_us_of_slope[j * $_P + i] * slope[i];
        }
        for (int a = 0; a < $_N; ++a) {
            xs[a] = @_xs[a];
            for (int i = 0; i < $_P; ++i) {
                xs[a] += @_xs_of_bias[a * $_P + i] * bias[i] + @_xs_of_slope[a * $_P + i] * slope[i];
                xs[a] += @_xs_of_target[a * $_P + i] * (s->goal[i] - @_first_target[i]);
            }
            x[a] = s->now.x[a] - xs[a];
        }
        code = @_policy(&s->plan, x, xs, us, acted, v);
        lost = code == $_HELD;
        for (int j = 0; j < $_M; ++j) {
            v[j] += us[j];
            lost = lost || !@_fits(v[j], $_HUGE);
        }
        for (int j = 0; j < $_M && !lost; ++j) {
            v[j] = @_within(v[j], acted[j] - @_most_rate[j], acted[j] + @_most_rate[j]);
            s->u[j] = @_within(v[j], @_floor[j], @_ceiling[j]);
        }
        runs = !lost;
    }
    if (lost) { /* the window begins anew */
        s->row = s->alike = $_R(0);
        s->full = s->raised = s->doubted = 0;
    } else {
        for (int i = 0; i < $_P; ++i)
            s->bias[i] = bias[i];
    }
    if (!runs)
        code = s->started ? $_HELD : $_WAITS;
    else if (code == $_OK && !complete)
        code = $_FILLED;
    s->started = s->started || runs;
    for (int i = 0; i < $_P; ++i) { /* the target is that of the next call */
        s->target[i] = s->goal[i] + slope[i];
        s->slope[i] = $_R(0);
    }
    for (int j = 0; j < $_M; ++j)
        u[j] = s->applied[j] = s->u[j];
    return code;
}
