//! The best control of exact data, refined, with bounds on its rounding and on the least distance.
//!
//! With `C = C_K` and `y = xf - A^K x0`, the best control `v* = C^+ y` and the residual `r* = y - C v*` solve
//! `f = y - r - C v = 0`, `g = C^T r = 0`, `h = v - C^T w = 0` for some w. All three are computed in twice the
//! precision along the motion, so that neither `C` nor `A^K` is rounded; the corrections follow from the singular
//! vectors (Bjorck, BIT 7 (1967) 257-278). For any v, r, w, and s at most the least singular value of `C` that is not
//! 0:
//!
//! ```text
//! v - v* = (I - C^+ C) h - C^+ f - C^+ C^+^T g        ||v - v*|| <= ||h|| + ||f|| / s + ||g|| / s^2
//! C (v - v*) = -P f - C^+^T g                          ||C (v - v*)|| <= ||f|| + ||g|| / s
//! ```

use super::pairs::{Motion, Pairs, UPWARD, norm_scaled};
use crate::error::Result;
use crate::fuse::power_of_two_scale;
use crate::memory::{try_collect, try_zeros};
use crate::parallel::Stop;
use crate::vector::{axpy, dot};

const WHAT: &str = "a control in twice the precision";
/// Corrections at most. Each gains a factor of about `eps condition`.
const MOST: usize = 20;
/// A correction that gains less than this factor is the last one.
const GAIN: f64 = 0.7;
/// Times `||y|| / ||C||`: the controls that [`Best::lower`] is about where the rank is not certain. A larger one can
/// act in a direction that cannot be told from one without effect in twice the precision.
const LARGEST: f64 = 1e20;
/// Seven bits more than a double has.
const ENOUGH: f64 = f64::EPSILON / 256.0;

/// Singular vectors and values above the cut-off, as in [`Pseudoinverse`](super::Pseudoinverse).
#[derive(Debug, Clone, Copy)]
pub struct Factors<'a> {
    /// Left singular vectors, vector by vector.
    pub basis: &'a [f64],
    /// Right singular vectors.
    pub right: &'a [f64],
    /// Singular values, at least as many.
    pub singular_values: &'a [f64],
    /// A lower bound of the least singular value of the exact matrix that is not 0; not positive: none is known.
    pub gap: f64,
}

/// The best control and what is known of it.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Best {
    /// The control in the order of `C_K`, the nearest doubles.
    pub control: Vec<f64>,
    /// `A^K x0`, `xf - A^K x0` and `(I - C C^+)(xf - A^K x0)`, rounded to doubles.
    pub free: Vec<f64>,
    /// See `free`.
    pub needed: Vec<f64>,
    /// See `free`.
    pub residual: Vec<f64>,
    /// `C (control - v*)` but for what `state_rounding` has above its norm.
    pub shift: Vec<f64>,
    /// `||control - v*||` is at most this, infinite if `gap` says nothing.
    pub control_rounding: f64,
    /// `||C (control - v*)||` is at most this.
    pub state_rounding: f64,
    /// `min ||y - C v||` is at most this.
    pub upper: f64,
    /// No v with `||v|| <= size` has a smaller `||y - C v||`.
    pub lower: f64,
    /// Infinite if `lower` holds for all controls.
    pub size: f64,
    /// `|| |A| |A^{K-1} x0| + |xf| ||`, the unit of the rounding of `xf - A^K x0` in doubles.
    pub unit: f64,
}

/// `C_K^+ (xf - A^K x0)`, given the factors of `C_K`, with its rounding.
///
/// # Errors
/// [`Error::Memory`](crate::Error::Memory), [`Error::Interrupted`](crate::Error::Interrupted) after a stop.
pub fn best_control(motion: &Motion<'_>, factors: &Factors<'_>, x0: &[f64], xf: &[f64], stop: &Stop) -> Result<Best> {
    // scaled by powers of two, which is exact: the entries of B and of the states are below 2
    let (unit, gain) = (power_of_two_scale(x0.iter().chain(xf)), power_of_two_scale(motion.b));
    let b = try_collect(WHAT, motion.b.iter().map(|b| b / gain))?;
    let motion = &Motion { b: &b, ..*motion };
    let scaled = |x: &[f64]| try_collect(WHAT, x.iter().map(|x| x / unit));
    let (free, mut sizes) = motion.free(&scaled(x0)?)?;
    let goal = scaled(xf)?;
    let mut needed = Pairs::exact(&goal)?;
    needed.subtract(&free);
    sizes.iter_mut().zip(&goal).for_each(|(size, goal)| *size += goal.abs());
    let found = Refined::new(motion, factors, gain, &needed, stop)?;
    let back = |x: &[f64]| try_collect(WHAT, x.iter().map(|x| x * unit));
    let control = try_collect(WHAT, found.v.high.iter().map(|v| v / gain * unit))?;
    // control = v - low
    let lost = motion.pushed(&found.v.lows()?)?;
    let norm = factors.singular_values.first().copied().unwrap_or(0.0) / gain;
    let largest = LARGEST * norm_scaled(&needed.high) / norm.max(f64::MIN_POSITIVE);
    let bounds = found.bounds(lost.norm_above(), factors.gap / gain, largest);
    Ok(Best {
        control,
        free: back(&free.high)?,
        needed: back(&needed.high)?,
        residual: back(&found.r.high)?,
        shift: try_collect(WHAT, lost.high.iter().map(|x| -x * unit))?,
        control_rounding: bounds.control / gain * unit,
        state_rounding: bounds.state * unit,
        upper: bounds.upper * unit,
        lower: bounds.lower * unit,
        size: bounds.size / gain * unit,
        unit: norm_scaled(&sizes) * unit,
    })
}

/// `C_K (high + low)` for a control in the order of `C_K`, rounded to doubles, and a bound on its error before that.
///
/// # Errors
/// [`Error::Memory`](crate::Error::Memory).
pub(super) fn pushed(motion: &Motion<'_>, high: &[f64], low: &[f64]) -> Result<(Vec<f64>, f64)> {
    let mut u = Pairs::exact(high)?;
    u.low.copy_from_slice(low);
    let state = motion.pushed(&u)?;
    let off = norm_scaled(&state.error);
    Ok((state.high, UPWARD * off))
}

/// v, r and w, and the norms of f, g and h.
struct Refined {
    v: Pairs,
    r: Pairs,
    w: Pairs,
    off: [f64; 3],
    rank: usize,
}

/// The numbers of [`Best`], scaled.
struct Bounds {
    control: f64,
    state: f64,
    upper: f64,
    lower: f64,
    size: f64,
}

impl Refined {
    fn new(motion: &Motion<'_>, factors: &Factors<'_>, gain: f64, needed: &Pairs, stop: &Stop) -> Result<Self> {
        let (n, width) = (motion.n, motion.width()?);
        let rank = factors.basis.len() / n;
        let s = try_collect(WHAT, factors.singular_values[..rank].iter().map(|s| s / gain))?;
        let least = s.last().copied().unwrap_or(1.0);
        let zeros = |len| Pairs::zeros(len);
        let mut now = Self { v: zeros(width)?, r: zeros(n)?, w: zeros(n)?, off: [f64::INFINITY; 3], rank };
        let mut kept: Option<(f64, Self)> = None;
        for _ in 0..=MOST {
            stop.check()?;
            let (f, g, h) = now.missed(motion, needed)?;
            now.off = [&f, &g, &h].map(Pairs::norm_above);
            let total = now.off[2] + (now.off[0] + now.off[1] / least) / least;
            let before = kept.as_ref().map_or(f64::INFINITY, |(before, _)| *before);
            if total >= before || total.is_nan() {
                break;
            }
            let enough = total <= ENOUGH * norm_scaled(&now.v.high) || total > GAIN * before;
            let last = Self { v: now.v.try_clone()?, r: now.r.try_clone()?, w: now.w.try_clone()?, ..now };
            kept = Some((total, last));
            if enough {
                break;
            }
            now.correct(factors, &s, [&f.high, &g.high, &h.high])?;
        }
        Ok(kept.map_or(now, |(_, kept)| kept))
    }

    /// f, g and h.
    fn missed(&self, motion: &Motion<'_>, needed: &Pairs) -> Result<(Pairs, Pairs, Pairs)> {
        let (n, width) = (motion.n, motion.width()?);
        let mut f = needed.try_clone()?;
        f.subtract(&self.r);
        f.subtract(&motion.pushed(&self.v)?);
        let g = if self.rank < n { motion.adjoint(&self.r)? } else { Pairs::zeros(width)? };
        let mut h = Pairs::zeros(width)?;
        if self.rank < width {
            h = self.v.try_clone()?;
            h.subtract(&motion.adjoint(&self.w)?);
        }
        Ok((f, g, h))
    }

    /// With `C = U S V^T`: `dv = V S^-1 (U^T f + S^-1 V^T g) - (I - V V^T) h`, `dr = (I - U U^T) f - U S^-1 V^T g`,
    /// `dw = U S^-1 V^T (dv + h)`.
    fn correct(&mut self, factors: &Factors<'_>, s: &[f64], [f, g, h]: [&[f64]; 3]) -> Result<()> {
        let (n, width) = (f.len(), g.len());
        let (mut dv, mut dr, mut dw): (Vec<f64>, Vec<f64>, Vec<f64>) =
            (try_zeros(WHAT, width)?, try_zeros(WHAT, n)?, try_zeros(WHAT, n)?);
        dr.copy_from_slice(f);
        for (h, dv) in h.iter().zip(&mut dv) {
            *dv = -h;
        }
        let vectors = factors.basis.chunks_exact(n).zip(factors.right.chunks_exact(width));
        for ((left, right), s) in vectors.zip(s) {
            let (along, across, aside) = (dot(left, f), dot(right, g) / s, dot(right, h));
            axpy((along + across) / s + aside, right, &mut dv);
            axpy(-(along + across), left, &mut dr);
            axpy(((along + across) / s + aside) / s, left, &mut dw);
        }
        self.v.shift(&dv);
        if self.rank < n {
            self.r.shift(&dr);
        }
        if self.rank < width {
            self.w.shift(&dw);
        }
        Ok(())
    }

    /// `lost`: at least `||C low||`; `gap`: a lower bound of the least singular value that is not 0; `largest`: a size
    /// of controls. The bound of the state is one of the residual, too: `||r - r*|| <= ||f|| + ||C (v - v*)||`.
    fn bounds(&self, lost: f64, gap: f64, largest: f64) -> Bounds {
        let (n, width) = (self.r.high.len(), self.v.high.len());
        let [f, g, h] = self.off;
        let sure = gap > 0.0 || self.rank == 0;
        let (over, below) = (self.r.norm_above(), self.r.norm_below());
        // ||P r||
        let turned = if g == 0.0 {
            0.0
        } else if sure {
            (g / gap).min(over)
        } else {
            over
        };
        let exact = if !sure {
            f64::INFINITY
        } else if self.rank == 0 {
            h
        } else {
            h + (f + g / gap) / gap
        };
        let mut bounds = Bounds {
            control: UPWARD * norm_scaled(&self.v.low) + exact,
            state: lost + 2.0 * f + turned,
            upper: over + f,
            lower: 0.0,
            size: f64::INFINITY,
        };
        // ||y - C v'|| >= r^T (y - C v') / ||r|| = ||r|| + (r^T f + g^T (v - v')) / ||r||
        let nearest = |apart: f64| (below - f - if g == 0.0 { 0.0 } else { g * apart / below }).max(0.0);
        if self.rank == n && sure {
            bounds.upper = 0.0; // every y is within reach
        } else if g == 0.0 || (self.rank == width && sure) {
            bounds.lower = nearest(exact);
        } else if nearest(norm_scaled(&self.v.high) + largest) > 0.5 * below {
            (bounds.lower, bounds.size) = (nearest(norm_scaled(&self.v.high) + largest), largest);
        } else {
            // half of the distance, and the controls up to which it holds
            let size = (0.5 * below - f) * below / g - norm_scaled(&self.v.high);
            if size > 0.0 {
                (bounds.lower, bounds.size) = (0.5 * below, size);
            }
        }
        bounds
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::pseudoinverse;

    fn best(a: &[f64], b: &[f64], steps: usize, x0: &[f64], xf: &[f64]) -> Best {
        let n = x0.len();
        let motion = Motion { a, b, n, m: b.len() / n, steps };
        let width = motion.m * steps;
        let mut c = vec![0.0; n * width];
        for k in 0..width {
            let mut unit = Pairs::zeros(width).unwrap();
            unit.high[k] = 1.0;
            let column = motion.pushed(&unit).unwrap();
            (0..n).for_each(|i| c[i * width + k] = column.high[i]);
        }
        let p = pseudoinverse(&c, n, width).unwrap();
        let gap = p.singular_values.get(p.rank.wrapping_sub(1)).map_or(1.0, |s| 0.5 * s);
        let factors = Factors { basis: &p.basis, right: &p.right, singular_values: &p.singular_values, gap };
        best_control(&motion, &factors, x0, xf, &Stop::new()).unwrap()
    }

    #[test]
    fn nearly_equal_columns_keep_their_digits() {
        // B = [1 1; 0 e]: the control for (0, 1) is (-1/e, 1/e)
        let e = 2f64.powi(-40);
        let found = best(&[0.0; 4], &[1.0, 1.0, 0.0, e], 1, &[0.0; 2], &[0.0, 1.0]);
        assert_eq!(found.control, [-1.0 / e, 1.0 / e]);
        assert!(found.control_rounding < 1e-5 && found.upper == 0.0); // of 1.6e12
    }

    #[test]
    fn what_is_out_of_reach_is_bounded_from_both_sides() {
        // one column (1, 1e-9, 0), and (0, 0, 3) across it
        let found = best(&[0.0; 9], &[1.0, 1e-9, 0.0], 1, &[0.0; 3], &[2.0, 2e-9, 3.0]);
        assert!(found.lower <= 3.0 && 3.0 <= found.upper && found.upper - found.lower < 1e-14);
        assert!(found.size.is_infinite() && (found.control[0] - 2.0).abs() <= found.control_rounding);
        // a chain of two states beside one that nothing moves
        let a = [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5];
        let found = best(&a, &[0.0, 1.0, 0.0], 3, &[0.0, 0.0, 8.0], &[1.0, 1.0, 0.0]);
        assert!(found.lower <= 1.0 && 1.0 <= found.upper && found.upper - found.lower < 1e-14);
        assert!(found.size.is_infinite());
    }

    #[test]
    fn without_inputs_that_act_nothing_moves() {
        let found = best(&[1.0], &[0.0], 2, &[1.0], &[3.0]);
        assert_eq!(found.control, [0.0; 2]);
        assert!(found.lower <= 2.0 && 2.0 <= found.upper && found.upper - found.lower < 1e-14);
        assert!(found.control_rounding == 0.0 && found.state_rounding < 1e-15);
    }
}
