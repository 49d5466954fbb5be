//! The line search of SLSE: with inner products that are updated ([`State`]), or summed from the entries
//! ([`step_towards`]).

/// The coefficients of a step, `F <- u F + t X`.
#[derive(Clone, Copy)]
pub(super) struct Move {
    pub(super) t: f64,
    pub(super) u: f64,
    /// `t / u`, infinite for `u = 0`; kept so that a step has one division only
    pub(super) ratio: (f64, f64),
}

/// Inner products of `F` and the target `E*`. None is a difference of large sums: each has its own recursion.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct State {
    /// `||F||^2`
    pub(crate) ff: f64,
    /// `<E* - F, F>`
    pub(crate) al: f64,
    /// `||E* - F||^2`
    pub(crate) er: f64,
    /// `<F, S>`, `<S, S>`, `<S, E*>`: only with the safeguard
    pub(crate) fs: f64,
    pub(crate) ss: f64,
    pub(crate) sa: f64,
}

impl State {
    /// The step to the best point of `[F, X]`, given `<F, X>`, `<E*, X>`, `<X, X>`; updates `ff`, `al` and `er`.
    #[inline(always)]
    pub(super) fn line_search(&mut self, fx: f64, ax: f64, xx: f64) -> Move {
        let num = ((ax - self.al) - fx).max(0.0); // <E* - F, X - F>
        let rest = ((self.ff + xx) + (self.al - ax)) - fx; // <X - E*, X - F> = ||X - F||^2 - num
        let apart = (self.ff - fx) + (xx - fx); // ||X - F||^2, zero to the last bit for X = F
        if apart > 0.0 && rest > 0.0 {
            let den = num + rest;
            let t = num / den;
            let back = self.ff - fx; // <F, F - X>
            // with F' = F + t (X - F) and <E* - F', X - F> = 0:
            self.al += t * back;
            self.ff += t * (num - 2.0 * back);
            self.er -= t * num;
            Move { t, u: rest / den, ratio: (num, rest) }
        } else if apart > 0.0 && num > 0.0 {
            self.restart(ax, xx)
        } else {
            Move { t: 0.0, u: 1.0, ratio: (0.0, 1.0) }
        }
    }

    /// `F = X`
    pub(super) fn restart(&mut self, ax: f64, xx: f64) -> Move {
        self.er += 2.0 * (self.al - ax) + (self.ff + xx); // ||E*||^2 = er + 2 al + ff
        (self.ff, self.al) = (xx, ax - xx);
        Move { t: 1.0, u: 0.0, ratio: (1.0, 0.0) }
    }
}

/// `t = clip(num / den, 0, 1)`, and 0 if `den` is not positive.
pub(super) fn clipped(num: f64, den: f64) -> f64 {
    if den > 0.0 { (num / den).clamp(0.0, 1.0) } else { 0.0 }
}

/// `t = clip(<E* - F, X - F> / ||X - F||^2, 0, 1)` and `F <- (1 - t) F + t X`. `unit` scales the differences so that
/// their squares neither overflow nor vanish.
#[inline(always)]
pub(crate) fn step_towards(f: &mut [f64], x: impl Fn(usize) -> f64, target: &[f64], unit: f64) -> f64 {
    let (mut num, mut den) = (0.0, 0.0);
    for (k, (f, t)) in f.iter().zip(target).enumerate() {
        let d = (x(k) - f) * unit;
        num += ((t - f) * unit) * d;
        den += d * d;
    }
    let t = clipped(num, den);
    if t > 0.0 {
        f.iter_mut().enumerate().for_each(|(k, f)| *f += t * (x(k) - *f));
    }
    t
}
