
/* Plans within limits: the least (v - f)'W^-1 (v - f) over the rows low <= C v <= high of inputs, states and rates,
   by a dual active-set method (Goldfarb and Idnani 1983) on W, begun at the active limits of the call before. The
   factors L D L' of C W C' of the active rows are updated: no call factors anew. v has the inputs of all steps, then
   the states that have limits, which it may exceed at a cost: W = H^-1 without them, [I; G] H^-1 [I; G]' with them,
   and the inverse of the weight of the excess on the diagonal. */
#define $_V ($_STEPS * $_M)
#define $_ALL ($_V + $_STATES)
#define $_ROWS ($_ALL + $_RATES * $_V)

typedef struct {
    @_wide u[$_ALL];     /* the plan, step by step, and its states */
    @_wide f[$_ALL];     /* that without limits */
    @_wide base[$_ALL];  /* that from the state 0, to the target */
    @_wide size[$_ALL];  /* of the terms that made u */
    @_wide mu[$_ALL];    /* multipliers of the active rows */
    @_wide to[$_ALL];    /* what they would be without signs */
    @_wide pivot[$_ALL]; /* D */
    @_wide lower[$_ALL * ($_ALL + 1) / 2 + 1]; /* L below its diagonal, row by row */
    int set[$_ALL];      /* the active rows */
    int count;           /* how many */
    int exchanges;       /* of the last call; at most $_EXCHANGES */
    signed char side[$_ROWS]; /* -1: at its lower limit, 1: at the upper one */
    @_real about[$_M + $_RESTS]; /* the set point that limits are about */
} @_plan;

static inline @_wide @_pair(int i, int j)
{
    return i >= j ? @_inverse[i * (i + 1) / 2 + j] : @_inverse[j * (j + 1) / 2 + i];
}

/* The entry of v that a row is of; rows from $_ALL on are u_j - u_(j-m). */
static inline int @_place(int row)
{
    return $_RATES && row >= $_ALL ? row - $_ALL : row;
}

static inline int @_change(int row)
{
    return $_RATES && row >= $_ALL + $_M;
}

/* Entry i of W c, c a row. */
static inline @_wide @_across(int i, int row)
{
    int j = @_place(row);
    return @_change(row) ? @_pair(i, j) - @_pair(i, j - $_M) : @_pair(i, j);
}

static inline @_wide @_gram(int row, int other)
{
    int i = @_place(row);
    return @_change(row) ? @_across(i, other) - @_across(i - $_M, other) : @_across(i, other);
}

static inline @_wide @_value(const @_wide *v, int row)
{
    int i = @_place(row);
    return @_change(row) ? v[i] - v[i - $_M] : v[i];
}

/* The limit of a row about the set point `us`; the first rate is from the input that acts now. */
static inline @_wide @_limit(int row, int side, const @_real *us, const @_real *now)
{
    int i = @_place(row), j = i % $_M;
    if (row < $_ALL)
        return (side < 0 ? @_low[i] : @_high[i]) - us[i < $_V ? j : $_M + @_column[i - $_V]];
    return (side < 0 ? -@_rate[j] : @_rate[j]) + (i < $_M ? now[j] - us[j] : $_W(0));
}

/* A further active row; 0 if it depends on the others, with D^-1 L^-1 of its products where its row would be. */
static inline int @_enter(@_plan *p, int row)
{
    int k = p->count;
    @_wide *own = &p->lower[k * (k - 1) / 2], size = @_gram(row, row), rest = size;
    for (int i = 0; i < k; ++i) {
        const @_wide *l = &p->lower[i * (i - 1) / 2];
        @_wide v = @_gram(row, p->set[i]);
        for (int j = 0; j < i; ++j)
            v -= l[j] * own[j];
        own[i] = v;
    }
    for (int i = 0; i < k; ++i) {
        @_wide v = own[i] / p->pivot[i];
        rest -= own[i] * v;
        own[i] = v;
    }
    if (k == $_ALL || !(rest > $_W(100) * $_WIDE_EPS * size))
        return 0;
    p->pivot[k] = rest;
    p->set[k] = row;
    p->mu[k] = $_W(0);
    p->count = k + 1;
    return 1;
}

/* Without the active row k: a positive update of the factors behind it. */
static inline void @_leave(@_plan *p, int k)
{
    int last = p->count - 1;
    @_wide *w = p->to, a = p->pivot[k];
    for (int i = k + 1; i <= last; ++i)
        w[i] = p->lower[i * (i - 1) / 2 + k];
    for (int i = k + 1; i <= last; ++i) {
        @_wide v = w[i], d = p->pivot[i] + a * v * v, b = v * a / d;
        a *= p->pivot[i] / d;
        p->pivot[i] = d;
        for (int r = i + 1; r <= last; ++r) {
            @_wide *l = &p->lower[r * (r - 1) / 2 + i];
            w[r] -= v * *l;
            *l += b * w[r];
        }
    }
    for (int i = k; i < last; ++i) {
        @_wide *to = &p->lower[i * (i - 1) / 2], *from = &p->lower[(i + 1) * i / 2];
        for (int j = 0; j < i; ++j)
            to[j] = from[j < k ? j : j + 1];
        p->pivot[i] = p->pivot[i + 1];
        p->set[i] = p->set[i + 1];
        p->mu[i] = p->mu[i + 1];
    }
    p->count = last;
}

/* L' x = x */
static inline void @_back(const @_plan *p, @_wide *x)
{
    for (int i = p->count - 1; i > 0; --i)
        for (int j = 0; j < i; ++j)
            x[j] -= p->lower[i * (i - 1) / 2 + j] * x[i];
}

/* to = (C W C')^-1 (C v - b) over the active rows. */
static inline void @_aim(@_plan *p, const @_wide *v, const @_real *us, const @_real *now)
{
    for (int i = 0; i < p->count; ++i) {
        int row = p->set[i];
        @_wide x = @_value(v, row) - @_limit(row, p->side[row], us, now);
        for (int j = 0; j < i; ++j)
            x -= p->lower[i * (i - 1) / 2 + j] * p->to[j];
        p->to[i] = x;
    }
    for (int i = 0; i < p->count; ++i)
        p->to[i] /= p->pivot[i];
    @_back(p, p->to);
}

/* u = f - W C' mu */
static inline void @_move(@_plan *p)
{
    for (int i = 0; i < $_ALL; ++i) {
        @_wide v = p->f[i], size = v < $_W(0) ? -v : v;
        for (int k = 0; k < p->count; ++k) {
            @_wide by = @_across(i, p->set[k]) * p->mu[k];
            v -= by;
            size += by < $_W(0) ? -by : by;
        }
        p->u[i] = v;
        p->size[i] = size;
    }
}

static inline int @_fixed(int row)
{
    return row < $_ALL && !(@_low[row] < @_high[row]);
}

/* The active row that leaves first on the way of the multipliers by (x mu + y to), and how far that is. */
static inline int @_first(const @_plan *p, @_wide *far, int turn)
{
    int at = -1;
    for (int i = 0; i < p->count; ++i) {
        int row = p->set[i], side = p->side[row];
        @_wide by = turn ? $_W(-turn) * p->to[i] : p->to[i] - p->mu[i];
        @_wide end = turn ? by : p->to[i];
        if (@_fixed(row) || (side > 0 ? end >= $_W(0) : end <= $_W(0)))
            continue;
        @_wide t = -p->mu[i] / by;
        if (at < 0 ? turn || t < *far : t < *far) {
            *far = t;
            at = i;
        }
    }
    return at;
}

/* The row that is farthest beyond a limit, by more than rounding, with its side; -1 if there is none. */
static inline int @_beyond(const @_plan *p, const @_real *us, const @_real *now, int *side)
{
    int at = -1;
    @_wide most = $_W(0);
    for (int row = 0; row < $_ROWS; ++row) {
        int i = @_place(row);
        @_wide v = @_value(p->u, row), size = p->size[i];
        if (p->side[row])
            continue;
        if (@_change(row))
            size += p->size[i - $_M];
        for (int s = -1; s < 2; s += 2) {
            @_wide limit = @_limit(row, s, us, now), off = s < 0 ? limit - v : v - limit;
            if (off > most && off > $_W(32) * $_WIDE_EPS * (size + (limit < $_W(0) ? -limit : limit))) {
                most = off;
                at = row;
                *side = s;
            }
        }
    }
    return at;
}

static inline void @_blank(@_plan *p)
{
    for (int row = 0; row < $_ROWS; ++row)
        p->side[row] = 0;
    for (int i = 0; i < $_ALL; ++i) {
        p->u[i] = $_W(0);
        p->base[i] = @_offset[i];
    }
    for (int j = 0; j < $_M + $_RESTS; ++j)
        p->about[j] = $_R(0);
    p->count = 0;
    p->exchanges = 0;
}

/* Within the limits in any case, each step from the one before where a step leads there. */
static inline void @_clip(@_plan *p, const @_real *us, const @_real *now)
{
    for (int i = 0; i < $_V; ++i) {
        @_wide v = p->u[i];
        if ($_RATES) {
            @_wide before = i < $_M ? now[i] - us[i] : p->u[i - $_M];
            v = @_within(v, before - @_rate[i % $_M], before + @_rate[i % $_M]);
        }
        p->u[i] = @_within(v, @_low[i] - us[i % $_M], @_high[i] - us[i % $_M]);
    }
}

/* The row that a row was one step before; of the last step itself. */
static inline int @_later(int row)
{
    int next = row + $_M;
    if (row < $_V || row >= $_ALL)
        return next < $_V || (row >= $_ALL && next < $_ROWS) ? next : row;
    for (next = row + 1; next < $_ALL; ++next)
        if (@_column[next - $_V] == @_column[row - $_V])
            return next;
    return row;
}

/* The plan from the state x. */
static inline int @_solve(@_plan *p, const @_real *x, const @_real *now)
{
    const @_real *us = p->about;
    int done = 0;
    for (int i = 0; i < $_ALL; ++i) {
        @_wide v = p->base[i];
        for (int j = 0; j < $_N; ++j)
            v += @_map[i * $_N + j] * x[j];
        p->f[i] = v;
        if (!@_fits(v, $_LARGEST))
            return $_HELD;
    }
    /* the active limits of the last call, one step later; the last step once more */
    p->count = 0;
    for (int row = 0; row < $_ROWS; ++row) {
        signed char side = (signed char)(@_fixed(row) ? 1 : p->side[@_later(row)]);
        if (side && !@_fits(@_limit(row, side, us, now), $_LARGEST))
            side = 0;
        p->side[row] = side;
        if (side && !@_enter(p, row))
            p->side[row] = 0;
    }
    for (p->exchanges = 0; p->exchanges < $_EXCHANGES && !done; ++p->exchanges) {
        @_wide far = $_W(1);
        int side = 0, at, row;
        @_aim(p, p->f, us, now);
        at = @_first(p, &far, 0);
        for (int i = 0; i < p->count; ++i)
            p->mu[i] += at < 0 ? p->to[i] - p->mu[i] : far * (p->to[i] - p->mu[i]);
        if (at >= 0) {
            p->side[p->set[at]] = 0;
            @_leave(p, at);
            continue;
        }
        @_move(p);
        row = @_beyond(p, us, now, &side);
        if (row < 0) { /* the best: once more for the rounding of the factors */
            @_aim(p, p->u, us, now);
            for (int i = 0; i < p->count; ++i)
                p->mu[i] += p->to[i];
            @_move(p);
            done = 1;
            continue;
        }
        p->side[row] = (signed char)side;
        /* a row that is a sum of active ones: their multipliers move along it until one of them leaves */
        at = 0;
        far = $_W(0);
        while (at >= 0 && !@_enter(p, row)) {
            int k = p->count;
            @_wide t = $_W(0);
            for (int i = 0; i < k; ++i)
                p->to[i] = p->lower[k * (k - 1) / 2 + i];
            @_back(p, p->to);
            at = @_first(p, &t, side);
            if (at < 0)
                continue;
            for (int i = 0; i < k; ++i)
                p->mu[i] -= t * (@_wide)side * p->to[i];
            far += t;
            p->side[p->set[at]] = 0;
            @_leave(p, at);
        }
        if (at < 0) { /* no room within the limits, but for rounding */
            p->side[row] = 0;
            break;
        }
        p->mu[p->count - 1] = far * (@_wide)side;
    }
    for (int i = 0; i < p->count; ++i) { /* exactly at the limits */
        int row = p->set[i];
        if (done && row < $_V)
            p->u[row] = @_limit(row, p->side[row], us, now);
    }
    @_clip(p, us, now);
    return done ? $_OK : $_INEXACT;
}
