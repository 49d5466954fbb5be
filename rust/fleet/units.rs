//! The units, and what a command does to each of them.

use crate::error::{Error, Result};
use crate::memory::{checked_len, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::simd::LANES;
use crate::vector::{axpy, dot};

pub(super) const WHAT: &str = "a command for a fleet";

/// Chunks of the units, whatever the number of threads.
const CHUNKS: usize = 64;

/// `size` units of `n` states and `m` inputs over `steps` steps, row by row.
#[derive(Clone, Copy)]
pub struct Units<'a> {
    /// `A_s`, `(size, n, n)`.
    pub a: &'a [f64],
    /// `B_s`, `(size, n, m)`.
    pub b: &'a [f64],
    /// `c_s`, `(size, n)`, or empty.
    pub c: &'a [f64],
    /// Where they begin: `(size, n)`, or `n` for all.
    pub x0: &'a [f64],
    /// Where they shall go, `n`.
    pub xf: &'a [f64],
    /// `F` with `F'F = Q`, `(rows, n)`.
    pub root: &'a [f64],
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
    /// Checks that the lengths fit together.
    ///
    /// # Errors
    /// [`Error::Shape`]
    pub fn checked(self) -> Result<Self> {
        let Self { n, m, size, steps, .. } = self;
        let square = checked_len(WHAT, size, checked_len(WHAT, n, n)?)?;
        let wanted = [
            ("A", self.a.len(), square),
            ("B", self.b.len(), checked_len(WHAT, size, checked_len(WHAT, n, m)?)?),
            ("c", self.c.len(), if self.c.is_empty() { 0 } else { size * n }),
            ("x0", self.x0.len(), if self.x0.len() == n { n } else { size * n }),
            ("xf", self.xf.len(), n),
            ("root", self.root.len(), self.root.len() / n.max(1) * n),
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
        Ok(self)
    }

    /// `d = K m`
    pub(super) fn inputs(&self) -> usize {
        self.steps * self.m
    }

    /// Rows of `F`.
    pub(super) fn rows(&self) -> usize {
        self.root.len() / self.n
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

    /// `M = F G_s` into `map` (rows, d), and `t = F b_s` into `target`.
    ///
    /// With `L_K = F`, `L_k = L_{k+1} A`: block k of M is `L_{k+1} B`, `t = F xf - L_0 x0 - sum_k L_{k+1} c`.
    #[inline(always)]
    pub(super) fn map(&self, s: usize, room: &mut Room, map: &mut [f64], target: &mut [f64]) {
        let (a, b, c, x0) = self.of(s);
        let (n, m, d, w) = (self.n, self.m, self.inputs(), room.width);
        for (i, row) in room.abc.chunks_exact_mut(w).enumerate() {
            row[..n].copy_from_slice(&a[i * n..][..n]);
            row[n..n + m].copy_from_slice(&b[i * m..][..m]);
            row[n + m] = *c.get(i).unwrap_or(&0.0);
        }
        room.left.copy_from_slice(self.root);
        for (t, row) in target.iter_mut().zip(self.root.chunks_exact(n)) {
            *t = dot(row, self.xf);
        }
        for k in (0..self.steps).rev() {
            products(&room.left, &room.abc, n, w, &mut room.next);
            for (i, row) in room.next.chunks_exact(w).enumerate() {
                room.left[i * n..][..n].copy_from_slice(&row[..n]);
                map[i * d + k * m..][..m].copy_from_slice(&row[n..n + m]);
                target[i] -= row[n + m];
            }
        }
        for (t, row) in target.iter_mut().zip(room.left.chunks_exact(n)) {
            *t -= dot(row, x0);
        }
    }

    /// `F (x_s(K) - xf)` into `residual`.
    pub(super) fn residual(&self, s: usize, u: &[f64], room: &mut Room, residual: &mut [f64]) {
        let (a, b, c, x0) = self.of(s);
        let (n, m) = (self.n, self.m);
        let (x, next) = (&mut room.x, &mut room.y);
        x.copy_from_slice(x0);
        for now in u.chunks_exact(m) {
            for (i, to) in next.iter_mut().enumerate() {
                *to = dot(&a[i * n..][..n], x) + dot(&b[i * m..][..m], now) + c.get(i).unwrap_or(&0.0);
            }
            std::mem::swap(x, next);
        }
        x.iter_mut().zip(self.xf).for_each(|(x, xf)| *x -= xf);
        for (r, row) in residual.iter_mut().zip(self.root.chunks_exact(n)) {
            *r = dot(row, x);
        }
    }

    /// `gradient += G_s' F' residual`, by the costates `p_K = F' residual`, `p_k = A' p_{k+1}`.
    pub(super) fn pull(&self, s: usize, residual: &[f64], room: &mut Room, gradient: &mut [f64]) {
        let (a, b, ..) = self.of(s);
        let (n, m) = (self.n, self.m);
        let (p, next) = (&mut room.x, &mut room.y);
        p.fill(0.0);
        for (r, row) in residual.iter().zip(self.root.chunks_exact(n)) {
            axpy(*r, row, p);
        }
        for g in gradient.chunks_exact_mut(m).rev() {
            next.fill(0.0);
            for (i, p) in p.iter().enumerate() {
                axpy(*p, &b[i * m..][..m], g);
                axpy(*p, &a[i * n..][..n], next);
            }
            std::mem::swap(p, next);
        }
    }

    /// The miss of every unit under `u`, `beside` the square that the inputs cost.
    ///
    /// # Errors
    /// [`Error::Overflow`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn misses(&self, u: &[f64], beside: f64, threads: usize, stop: &Stop) -> Result<Vec<f64>> {
        let mut found = try_zeros(WHAT, self.size)?;
        let chunk = self.chunk();
        let threads = self.threads(threads, self.work());
        for_each_chunk(found.chunks_mut(chunk).enumerate(), threads, stop, |(block, out)| {
            let mut room = Room::new(self)?;
            let mut residual = try_zeros(WHAT, self.rows())?;
            for (i, miss) in out.iter_mut().enumerate() {
                self.residual(block * chunk + i, u, &mut room, &mut residual);
                *miss = (dot(&residual, &residual) + beside).sqrt();
            }
            Ok(())
        })?;
        match found.iter().all(|miss| miss.is_finite()) {
            true => Ok(found),
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
        Ok(Self {
            width,
            abc: try_zeros(WHAT, checked_len(WHAT, n, width)?)?,
            left: try_zeros(WHAT, units.root.len())?,
            next: try_zeros(WHAT, checked_len(WHAT, units.rows(), width)?)?,
            x: try_zeros(WHAT, n)?,
            y: try_zeros(WHAT, n)?,
        })
    }
}
