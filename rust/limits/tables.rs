//! Many small problems with one `M`: the inverse of every free block is kept in a table.

use super::bounds::Bounds;
use super::dense::Dense;
use super::kernel::{Work, widest};
use super::quadratic::{Quadratic, Until};
use crate::error::Result;
use crate::memory::{try_collect, try_room};
use crate::parallel::Stop;

const WHAT: &str = "the tables of free inputs";

/// Most inputs: `2^d` blocks of `d^2` numbers.
const MOST: usize = 8;
/// Rounds of pivoting, after sweeps of coordinate descent; what is left then is solved one by one.
const PIVOTS: usize = 8;
const SWEEPS: usize = 2;

/// Solves a chunk of problems.
pub(super) trait Chunk: Sync {
    /// Controls `u` of the rows of `y`, and their gaps; returns how many are missing: they begin with NaN.
    fn solve(&self, y: &[f64], u: &mut [f64], gaps: Option<&mut [f64]>) -> usize;
}

/// Tables for the problems of `dense`, if it is small and has an inverse.
pub(super) fn tables(
    dense: &mut Dense,
    bounds: Bounds<'_>,
    rows: usize,
    stop: &Stop,
) -> Result<Option<Box<dyn Chunk>>> {
    if dense.d > MOST || dense.inverse().is_none() {
        return Ok(None);
    }
    Ok(Some(match dense.d {
        1 => Box::new(Table::<1>::new(dense, bounds, rows, stop)?),
        2 => Box::new(Table::<2>::new(dense, bounds, rows, stop)?),
        3 => Box::new(Table::<3>::new(dense, bounds, rows, stop)?),
        4 => Box::new(Table::<4>::new(dense, bounds, rows, stop)?),
        5 => Box::new(Table::<5>::new(dense, bounds, rows, stop)?),
        6 => Box::new(Table::<6>::new(dense, bounds, rows, stop)?),
        7 => Box::new(Table::<7>::new(dense, bounds, rows, stop)?),
        _ => Box::new(Table::<8>::new(dense, bounds, rows, stop)?),
    }))
}

struct Table<const D: usize> {
    /// Rows of `M` that belong to `y`, and those below, for which it is 0.
    m: Vec<[f64; D]>,
    rows: usize,
    r: [f64; D],
    h: [[f64; D]; D],
    /// One over the diagonal of `H`.
    scale: [f64; D],
    low: [f64; D],
    high: [f64; D],
    /// Bits of the inputs that are not fixed.
    moving: usize,
    /// `H_FF^{-1}`, with zeros elsewhere, for the free inputs whose bits are set in the index.
    inverse: Vec<[[f64; D]; D]>,
}

impl<const D: usize> Table<D> {
    fn new(dense: &mut Dense, bounds: Bounds<'_>, rows: usize, stop: &Stop) -> Result<Self> {
        let mut inverse = try_room(WHAT, 1 << D)?;
        for free in 0..1 << D {
            let held: [i8; D] = std::array::from_fn(|i| 1 - (free >> i & 1) as i8);
            let mut block = [[0.0; D]; D];
            dense.barrier(&held, &[0.0; D], Until::new(stop, None))?;
            for (i, row) in block.iter_mut().enumerate().filter(|(i, _)| free >> i & 1 == 1) {
                row[i] = 1.0;
                dense.newton(row);
            }
            inverse.push(block);
        }
        let (ld, h) = (dense.ld, &dense.h);
        let line = |row: &[f64]| std::array::from_fn(|i| row[i]);
        Ok(Self {
            m: try_collect(WHAT, dense.m.chunks_exact(ld).map(line))?,
            rows,
            r: line(&dense.r),
            h: std::array::from_fn(|i| line(&h[i * ld..])),
            scale: std::array::from_fn(|i| 1.0 / h[i * ld + i]),
            low: line(bounds.low),
            high: line(bounds.high),
            moving: (0..D).filter(|&i| !bounds.fixed(i)).map(|i| 1 << i).sum(),
            inverse,
        })
    }

    #[inline(always)]
    fn clip(&self, i: usize, v: f64) -> f64 {
        let v = if v < self.low[i] { self.low[i] } else { v };
        (if v > self.high[i] { self.high[i] } else { v }) + 0.0
    }

    /// The control for `f = M'y`; `None` after too many rounds.
    #[inline(always)]
    #[expect(clippy::needless_range_loop, reason = "loops over arrays of a fixed size")]
    fn control(&self, f: &[f64; D]) -> Option<[f64; D]> {
        let all = (1 << D) - 1;
        let mut u = times(&self.inverse[all], f);
        let mut inside = true;
        for i in 0..D {
            inside &= self.low[i] <= u[i] && u[i] <= self.high[i];
        }
        if inside {
            return Some(u);
        }
        for i in 0..D {
            u[i] = self.clip(i, u[i]);
        }
        for _ in 0..SWEEPS {
            for i in 0..D {
                let mut g = -f[i];
                for j in 0..D {
                    g += self.h[i][j] * u[j];
                }
                u[i] = self.clip(i, u[i] - g * self.scale[i]);
            }
        }
        // bits of the inputs at their lower and at their upper limit
        let (mut low, mut high) = (0, 0);
        for i in 0..D {
            low |= usize::from(u[i] <= self.low[i]) << i;
            high |= usize::from(u[i] >= self.high[i]) << i;
        }
        high |= all & !self.moving;
        low &= self.moving & !high;
        for _ in 0..PIVOTS {
            let free = all & !(low | high);
            let mut held = [0.0; D];
            for i in 0..D {
                let limit = if low >> i & 1 == 1 { self.low[i] } else { self.high[i] };
                held[i] = if free >> i & 1 == 1 { 0.0 } else { limit };
            }
            let mut right = times(&self.h, &held);
            for i in 0..D {
                right[i] = f[i] - right[i];
            }
            u = times(&self.inverse[free], &right);
            let change = times(&self.h, &u);
            let (mut below, mut above, mut back) = (0, 0, 0);
            for i in 0..D {
                let (is_free, slope) = (free >> i & 1, change[i] - right[i]);
                below |= (usize::from(u[i] < self.low[i]) & is_free) << i;
                above |= (usize::from(u[i] > self.high[i]) & is_free) << i;
                back |= ((usize::from(slope < 0.0) & low >> i | usize::from(slope > 0.0) & high >> i) & 1) << i;
                u[i] += held[i];
            }
            back &= self.moving;
            if below | above | back == 0 {
                for i in 0..D {
                    u[i] = self.clip(i, u[i]);
                }
                return Some(u);
            }
            low = low & !back | below;
            high = high & !back | above;
        }
        None
    }

    /// The certificate of one control, as in a single problem.
    #[inline(always)]
    fn gap(&self, y: &[f64], u: &[f64; D]) -> f64 {
        let mut g: [f64; D] = std::array::from_fn(|i| self.r[i] * u[i]);
        for (k, row) in self.m.iter().enumerate() {
            let image: f64 = row.iter().zip(u).map(|(a, u)| a * u).sum();
            let residual = image - y.get(k).copied().unwrap_or(0.0);
            g.iter_mut().zip(row).for_each(|(g, a)| *g += a * residual);
        }
        let (mut frank_wolfe, mut e) = (0.0, [0.0; D]);
        for i in 0..D {
            let to = if g[i] > 0.0 { self.low[i] } else { self.high[i] };
            if g[i] != 0.0 && to != u[i] {
                frank_wolfe += 2.0 * g[i] * (u[i] - to);
                e[i] = g[i];
            }
        }
        let squared: f64 = times(&self.inverse[self.moving], &e).iter().zip(&e).map(|(v, e)| v * e).sum();
        frank_wolfe.min(squared.abs())
    }
}

/// `a v`
#[inline(always)]
fn times<const D: usize>(a: &[[f64; D]; D], v: &[f64; D]) -> [f64; D] {
    let mut out = [0.0; D];
    // a is symmetric: by columns
    for (column, v) in a.iter().zip(v) {
        for i in 0..D {
            out[i] += column[i] * v;
        }
    }
    out
}

/// One chunk, for each width of registers.
struct Part<'a, const D: usize> {
    table: &'a Table<D>,
    y: &'a [f64],
    u: &'a mut [f64],
    gaps: Option<&'a mut [f64]>,
}

impl<const D: usize> Work for Part<'_, D> {
    type Out = usize;

    #[inline(always)]
    fn run(self) -> usize {
        let Self { table, y, u, mut gaps } = self;
        let mut missing = 0;
        for (s, (y, u)) in y.chunks_exact(table.rows).zip(u.as_chunks_mut::<D>().0).enumerate() {
            let mut f = [0.0; D];
            for (y, row) in y.iter().zip(&table.m) {
                for i in 0..D {
                    f[i] += row[i] * y;
                }
            }
            match table.control(&f) {
                Some(found) => {
                    *u = found;
                    if let Some(gaps) = gaps.as_deref_mut() {
                        gaps[s] = table.gap(y, u);
                    }
                }
                None => {
                    u[0] = f64::NAN;
                    missing += 1;
                }
            }
        }
        missing
    }
}

impl<const D: usize> Chunk for Table<D> {
    fn solve(&self, y: &[f64], u: &mut [f64], gaps: Option<&mut [f64]>) -> usize {
        widest(Part { table: self, y, u, gaps })
    }
}
