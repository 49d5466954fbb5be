//! The units, and what a command does to each of them.

use crate::error::{Error, Result, require_finite};
use crate::memory::{checked_len, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::simd::LANES;
use crate::vector::{axpy, dot};

pub(super) const WHAT: &str = "a command for a fleet";

/// Chunks of the units, whatever the number of threads.
const CHUNKS: usize = 64;

/// `size` units of `n` states and `m` inputs over `steps` steps, row by row.
#[derive(Debug, Clone, Copy)]
pub struct Units<'a> {
    /// `A_s`, `(size, n, n)`.
    pub a: &'a [f64],
    /// `B_s`, `(size, n, m)`.
    pub b: &'a [f64],
    /// `c_s`, `(size, n)`, or empty.
    pub c: &'a [f64],
    /// Where they begin: `(size, n)`, or `n` for all.
    pub x0: &'a [f64],
    /// What is wanted of `x(1) .. x(K)`, `(steps, n)`.
    pub reference: &'a [f64],
    /// `F` with `F'F = Q` of `x(1) .. x(K-1)`, `(rows, n)`, or empty: a root of a weight, see [`crate::limits::root`].
    pub stage: &'a [f64],
    /// The same of `x(K)`.
    pub terminal: &'a [f64],
    /// Number of states.
    pub n: usize,
    /// Number of inputs.
    pub m: usize,
    /// Number of steps.
    pub steps: usize,
    /// Number of units.
    pub size: usize,
}

impl<'a> Units<'a> {
    /// Checks that the lengths fit together and that all are numbers, as all that is done with the units does.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`].
    pub fn checked(self) -> Result<Self> {
        let Self { n, m, size, steps, .. } = self;
        let square = checked_len(WHAT, size, checked_len(WHAT, n, n)?)?;
        let wanted = [
            ("A", self.a.len(), square),
            ("B", self.b.len(), checked_len(WHAT, size, checked_len(WHAT, n, m)?)?),
            ("c", self.c.len(), if self.c.is_empty() { 0 } else { size * n }),
            ("x0", self.x0.len(), if self.x0.len() == n { n } else { size * n }),
            ("reference", self.reference.len(), checked_len(WHAT, steps, n)?),
            ("stage", self.stage.len(), self.stage.len() / n.max(1) * n),
            ("terminal", self.terminal.len(), self.terminal.len() / n.max(1) * n),
        ];
        for (name, found, expected) in wanted {
            if found != expected {
                let (expected, found) = (format!("{expected} entries"), format!("{found} entries"));
                return Err(Error::Shape { name, expected, found });
            }
        }
        if n == 0 || m == 0 || steps == 0 || size == 0 {
            let found = format!("{size} units, n={n}, m={m}, {steps} steps");
            return Err(Error::Shape { name: "A", expected: "at least one of each".into(), found });
        }
        checked_len(WHAT, steps, m)?;
        checked_len(WHAT, steps, self.stage.len())?;
        let all = [("A", self.a), ("B", self.b), ("c", self.c), ("x0", self.x0), ("reference", self.reference)];
        for (name, values) in all.into_iter().chain([("stage", self.stage), ("terminal", self.terminal)]) {
            require_finite(name, values)?;
        }
        Ok(self)
    }

    /// `d = K m`
    pub(super) fn inputs(&self) -> usize {
        self.steps * self.m
    }

    /// Rows of the map of a unit: those of the steps, then those of the last state.
    pub(super) fn rows(&self) -> usize {
        ((self.steps - 1) * self.stage.len() + self.terminal.len()) / self.n
    }

    /// The root of the weight of `x(k+1)`.
    fn root(&self, k: usize) -> &'a [f64] {
        if k + 1 < self.steps { self.stage } else { self.terminal }
    }

    /// Operations for a step of all units.
    pub(super) fn work(&self) -> f64 {
        (self.size * self.steps) as f64 * (self.n * (self.n + self.m)) as f64
    }

    /// Units in a chunk.
    pub(super) fn chunk(&self) -> usize {
        self.size.div_ceil(CHUNKS).max(16)
    }

    /// One thread where others would take longer to start.
    pub(super) fn threads(&self, threads: usize, work: f64) -> usize {
        if work < 2e6 { 1 } else { threads }
    }

    fn of(&self, s: usize) -> (&'a [f64], &'a [f64], &'a [f64], &'a [f64]) {
        let (n, m) = (self.n, self.m);
        let c = if self.c.is_empty() { self.c } else { &self.c[s * n..][..n] };
        let x0 = if self.x0.len() == n { self.x0 } else { &self.x0[s * n..][..n] };
        (&self.a[s * n * n..][..n * n], &self.b[s * n * m..][..n * m], c, x0)
    }

    /// Whether two units are equal.
    pub(super) fn same(&self, s: usize, other: usize) -> bool {
        self.of(s) == self.of(other)
    }

    /// `M = F G_s` into `map` (rows, d), and `t = F b_s` into `target`, for the weighed states one below the other.
    #[inline(always)]
    pub(super) fn map(&self, s: usize, room: &mut Room, map: &mut [f64], target: &mut [f64]) {
        let steps = target.len() - self.terminal.len() / self.n;
        let (of_steps, of_last) = map.split_at_mut(steps * self.inputs());
        let (to_steps, to_last) = target.split_at_mut(steps);
        if steps > 0 {
            self.states(s, self.stage, (0, self.steps - 1), room, of_steps, to_steps);
        }
        self.states(s, self.terminal, (self.steps - 1, self.steps), room, of_last, to_last);
        let mut from = 0;
        for (k, wanted) in self.reference.chunks_exact(self.n).enumerate() {
            let root = self.root(k);
            for (t, row) in target[from..].iter_mut().zip(root.chunks_exact(self.n)) {
                *t += dot(row, wanted);
            }
            from += root.len() / self.n;
        }
    }

    /// `L x(k+1) = M u - t` for the `k` of a range, one below the other: M into `map`, t into `target`.
    ///
    /// With `L_0 = L`, `L_p = L_{p-1} A`: the block of input j is `L_{k-j} B`, `t = -L_{k+1} x0 - sum_{p <= k} L_p c`.
    #[inline(always)]
    pub(super) fn states(
        &self,
        s: usize,
        root: &[f64],
        (first, end): (usize, usize),
        room: &mut Room,
        map: &mut [f64],
        target: &mut [f64],
    ) {
        let (a, b, c, x0) = self.of(s);
        let (n, m, d, w, q) = (self.n, self.m, self.inputs(), room.width, root.len() / self.n);
        for (i, row) in room.abc.chunks_exact_mut(w).enumerate() {
            row[..n].copy_from_slice(&a[i * n..][..n]);
            row[n..n + m].copy_from_slice(&b[i * m..][..m]);
            row[n + m] = *c.get(i).unwrap_or(&0.0);
        }
        let (left, next) = (&mut room.left[..q * n], &mut room.next[..q * w]);
        left.copy_from_slice(root);
        map.fill(0.0);
        target.fill(0.0);
        for p in 0..end {
            products(left, &room.abc, n, w, next);
            for (i, row) in next.chunks_exact(w).enumerate() {
                left[i * n..][..n].copy_from_slice(&row[..n]);
                for k in p.max(first)..end {
                    let at = (k - first) * q + i;
                    map[at * d + (k - p) * m..][..m].copy_from_slice(&row[n..n + m]);
                    target[at] -= row[n + m];
                }
            }
            if p >= first {
                let at = (p - first) * q;
                for (t, row) in target[at..at + q].iter_mut().zip(left.chunks_exact(n)) {
                    *t -= dot(row, x0);
                }
            }
        }
    }

    /// `F (x_s(k) - r(k))`, one below the other, into `residual`; and by how much the states leave `limits` most.
    pub(super) fn residual(
        &self,
        s: usize,
        u: &[f64],
        limits: Option<(&[f64], &[f64])>,
        room: &mut Room,
        residual: &mut [f64],
    ) -> f64 {
        let (a, b, c, x0) = self.of(s);
        let (n, m) = (self.n, self.m);
        let (x, next) = (&mut room.x, &mut room.y);
        x.copy_from_slice(x0);
        let (mut from, mut excess) = (0, 0.0f64);
        for (k, now) in u.chunks_exact(m).enumerate() {
            for (i, to) in next.iter_mut().enumerate() {
                *to = dot(&a[i * n..][..n], x) + dot(&b[i * m..][..m], now) + c.get(i).unwrap_or(&0.0);
            }
            std::mem::swap(x, next);
            if let Some((low, high)) = limits {
                let sides = low[k * n..].iter().zip(&high[k * n..]);
                excess = x.iter().zip(sides).fold(excess, |most, (x, (l, h))| most.max(x - h).max(l - x));
            }
            let root = self.root(k);
            if root.is_empty() {
                continue;
            }
            next.iter_mut().zip(x.iter().zip(&self.reference[k * n..])).for_each(|(e, (x, r))| *e = x - r);
            for (r, row) in residual[from..].iter_mut().zip(root.chunks_exact(n)) {
                *r = dot(row, next);
            }
            from += root.len() / n;
        }
        excess
    }

    /// `x_s(1) .. x_s(K)` into `path` (steps, n).
    pub(super) fn path(&self, s: usize, u: &[f64], path: &mut [f64]) {
        let (a, b, c, x0) = self.of(s);
        let (n, m) = (self.n, self.m);
        for (k, now) in u.chunks_exact(m).enumerate() {
            let (before, to) = path.split_at_mut(k * n);
            let x = if k == 0 { x0 } else { &before[(k - 1) * n..] };
            for (i, to) in to[..n].iter_mut().enumerate() {
                *to = dot(&a[i * n..][..n], x) + dot(&b[i * m..][..m], now) + c.get(i).unwrap_or(&0.0);
            }
        }
    }

    /// `gradient += G_s' F' residual`, by the costates `p_k = A' p_{k+1} + F_k' residual_k`.
    pub(super) fn pull(&self, s: usize, residual: &[f64], room: &mut Room, gradient: &mut [f64]) {
        let (a, b, ..) = self.of(s);
        let (n, m) = (self.n, self.m);
        let (p, next) = (&mut room.x, &mut room.y);
        p.fill(0.0);
        let mut end = residual.len();
        for (k, g) in gradient.chunks_exact_mut(m).enumerate().rev() {
            let root = self.root(k);
            let from = end - root.len() / n;
            for (r, row) in residual[from..end].iter().zip(root.chunks_exact(n)) {
                axpy(*r, row, p);
            }
            end = from;
            next.fill(0.0);
            for (i, p) in p.iter().enumerate() {
                axpy(*p, &b[i * m..][..m], g);
                axpy(*p, &a[i * n..][..n], next);
            }
            std::mem::swap(p, next);
        }
    }

    /// The miss of every unit under `u`, `beside` the square that the inputs cost, and by how much its states leave
    /// `limits` (steps, n) most.
    ///
    /// # Errors
    /// [`Error::Overflow`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn misses(
        &self,
        u: &[f64],
        beside: f64,
        limits: Option<(&[f64], &[f64])>,
        threads: usize,
        stop: &Stop,
    ) -> Result<(Vec<f64>, Vec<f64>)> {
        let (mut found, mut excess) = (try_zeros(WHAT, self.size)?, try_zeros(WHAT, self.size)?);
        let chunk = self.chunk();
        let threads = self.threads(threads, self.work());
        let parts = found.chunks_mut(chunk).zip(excess.chunks_mut(chunk));
        for_each_chunk(parts.enumerate(), threads, stop, |(block, (misses, beyond))| {
            let mut room = Room::new(self)?;
            let mut residual = try_zeros(WHAT, self.rows())?;
            for (i, (miss, beyond)) in misses.iter_mut().zip(beyond).enumerate() {
                *beyond = self.residual(block * chunk + i, u, limits, &mut room, &mut residual);
                *miss = (dot(&residual, &residual) + beside).sqrt();
            }
            Ok(())
        })?;
        match found.iter().chain(&excess).all(|v| v.is_finite()) {
            true => Ok((found, excess)),
            false => Err(Error::Overflow { what: "the miss of a unit" }),
        }
    }
}

/// `out = left [A B c]`, lines of `[A B c]` and of `out` padded to `w`.
#[inline(always)]
fn products(left: &[f64], abc: &[f64], n: usize, w: usize, out: &mut [f64]) {
    for (row, out) in left.chunks_exact(n).zip(out.chunks_exact_mut(w)) {
        for (t, out) in out.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
            let mut sum = [0.0; LANES];
            for (l, line) in row.iter().zip(abc.chunks_exact(w)) {
                let line = &line.as_chunks::<LANES>().0[t];
                (0..LANES).for_each(|j| sum[j] += l * line[j]);
            }
            *out = sum;
        }
    }
}

/// Work space for one unit.
pub(super) struct Room {
    width: usize,
    /// `[A B c]`, lines padded to `width`
    abc: Vec<f64>,
    left: Vec<f64>,
    next: Vec<f64>,
    x: Vec<f64>,
    y: Vec<f64>,
}

impl Room {
    pub(super) fn new(units: &Units<'_>) -> Result<Self> {
        let n = units.n;
        let width = (n + units.m + 1).next_multiple_of(LANES);
        let rows = (units.stage.len().max(units.terminal.len()) / n).max(1);
        Ok(Self {
            width,
            abc: try_zeros(WHAT, checked_len(WHAT, n, width)?)?,
            left: try_zeros(WHAT, checked_len(WHAT, rows, n)?)?,
            next: try_zeros(WHAT, checked_len(WHAT, rows, width)?)?,
            x: try_zeros(WHAT, n)?,
            y: try_zeros(WHAT, n)?,
        })
    }
}
