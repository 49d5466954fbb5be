//! Blocks beside the region in one loop: what is uncertain, nonlinear or late in it, and one proof for all of it
//! together.
//!
//! A channel adds `q = f(z)`, `||f(z)|| <= gamma ||z||`, to the inputs and states: `x+ = A x + B (u + U q) + E q`,
//! `z = H x + own q`. With the region's `p = G (W [x; u + U q])` the loop is
//!
//! ```text
//! x+ = A0 x + sum_i B_i v_i,    z_i = C_i x + sum_j D_ij v_j,    v_i = Delta_i(z_i),  ||Delta_i|| <= 1,
//! ```
//!
//! with `D_0j = gamma W_u U` where a channel goes through the inputs, as B is uncertain. All members are stable, with
//! one Lyapunov function, for any such f, if with multipliers t of the blocks (small gain; bounded-real lemma)
//!
//! ```text
//! diag(Q - X, T) - [A0 B; C D] diag(Q / lambda, T) [A0 B; C D]' > 0.
//! ```

use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, Par, Side};

use super::data::{Matrix, Uncertain, absolute, finite, gathered, stacked, symmetric};
use super::lemma::least;
use super::verify::{Claim, Judged, holds};

/// What is added to the right side of a proof, relative to what it stirs up, of that by which the blocks are larger.
const ROOM: f64 = 1e-1;

/// A block beside the region, in the units of the loop.
#[derive(Debug, Clone)]
pub(super) struct Channel {
    /// How q enters the states (n, k), and the inputs (m, k).
    pub e: Matrix,
    pub u: Matrix,
    /// `z = H x + own q` (l, n), (l, k).
    pub h: Matrix,
    pub own: Matrix,
}

impl Channel {
    /// Into the inputs `u`, of `h x`.
    pub fn at_inputs(u: Matrix, h: Matrix) -> Self {
        Self { e: Mat::zeros(h.ncols(), u.ncols()), own: Mat::zeros(h.nrows(), u.ncols()), u, h }
    }

    /// Into the states `e`, of `h x`.
    pub fn at_states(e: Matrix, h: Matrix, m: usize) -> Self {
        Self { u: Mat::zeros(m, e.ncols()), own: Mat::zeros(h.nrows(), e.ncols()), e, h }
    }
}

/// The loop of a gain with the region and channels, each channel with `gamma` 1.
#[derive(Debug)]
pub(super) struct Blocks {
    pub n: usize,
    /// `[A0; C]`, and bounds of the sums of absolute values in each entry.
    f: Matrix,
    f_sizes: Matrix,
    /// `[B; D]` of the channels.
    g: Matrix,
    g_sizes: Matrix,
    /// `rho D t^(1/2)` of the parts (n, R), and its square.
    pub inputs: Matrix,
    forcing: Matrix,
    /// The multiplier of each row of the parts in C.
    parts: Vec<f64>,
    /// The channel of each further row of C, and of each column of B.
    pub outs: Vec<usize>,
    pub ins: Vec<usize>,
    terms: usize,
    lift: f64,
}

/// `diag(a, a)`.
fn twice(a: &Matrix) -> Matrix {
    beside(a, &Mat::zeros(a.nrows(), a.ncols()))
}

/// `[re, -im; im, re]`: of size 2 n, as real numbers.
fn beside(re: &Matrix, im: &Matrix) -> Matrix {
    let (r, c) = (re.nrows(), re.ncols());
    Mat::from_fn(2 * r, 2 * c, |i, j| match (i < r, j < c) {
        (true, true) => re[(i, j)],
        (true, false) => -im[(i, j - c)],
        (false, true) => im[(i - r, j)],
        (false, false) => re[(i - r, j - c)],
    })
}

fn beside_each(a: &[Matrix], rows: usize) -> Matrix {
    let mut all = Mat::zeros(rows, 0);
    for block in a {
        let before = all.ncols();
        all.resize_with(rows, before + block.ncols(), |i, j| block[(i, j - before)]);
    }
    all
}

impl Blocks {
    /// The gain `k`, with an imaginary part where `turn` is given, multipliers `t` of the parts; without parts only the
    /// centre.
    pub fn new(data: &Uncertain, k: &Matrix, turn: Option<&Matrix>, t: &[f64], channels: &[Channel]) -> Self {
        let (n, m, pieces) = (data.n, data.m, &data.pieces[..t.len()]);
        let of_inputs = |w: &Matrix| w.subcols(n, m).to_owned();
        let joined = data.joined(k);
        let (mut c, mut c_sizes) = (Vec::new(), Vec::new());
        let (mut d, mut d_sizes) = (Vec::new(), Vec::new());
        let (mut b, mut b_sizes) = (Vec::new(), Vec::new());
        let (mut forcing, mut inputs, mut parts) = (Mat::<f64>::zeros(n, n), Vec::new(), Vec::new());
        for (piece, t) in pieces.iter().zip(t) {
            c.push(&piece.w * &joined);
            c_sizes.push(absolute(&piece.w) * absolute(&joined));
            parts.resize(parts.len() + piece.w.nrows(), *t);
            let mut input = Mat::<f64>::zeros(n, piece.rows.len());
            for (i, to) in piece.rows.iter().enumerate() {
                for (j, col) in piece.rows.iter().enumerate() {
                    forcing[(*to, *col)] += t * piece.rho * piece.rho * piece.s[(i, j)];
                    input[(*to, j)] = piece.rho * t.sqrt() * piece.root[(i, j)];
                }
            }
            inputs.push(input);
            let through = of_inputs(&piece.w);
            let of = |f: &dyn Fn(&Matrix, &Matrix) -> Matrix| {
                let each = gathered(channels.iter().map(|one| f(&through, &one.u)));
                beside_each(&each, through.nrows())
            };
            d.push(of(&|w, u| w * u));
            d_sizes.push(of(&|w, u| absolute(w) * absolute(u)));
        }
        let (mut outs, mut ins) = (Vec::new(), Vec::new());
        for (j, one) in channels.iter().enumerate() {
            c.push(one.h.clone());
            c_sizes.push(absolute(&one.h));
            b.push(&one.e + &data.b * &one.u);
            b_sizes.push(absolute(&one.e) + absolute(&data.b) * absolute(&one.u));
            outs.resize(outs.len() + one.h.nrows(), j);
            ins.resize(ins.len() + one.u.ncols(), j);
            let each = channels
                .iter()
                .enumerate()
                .map(|(i, other)| if i == j { one.own.clone() } else { Mat::zeros(one.h.nrows(), other.u.ncols()) });
            let row = beside_each(&gathered(each), one.h.nrows());
            d_sizes.push(absolute(&row));
            d.push(row);
        }
        let (a, a_sizes) = data.around(k);
        let width = ins.len();
        let mut made = Self {
            n,
            f: stacked([a].iter().chain(&c), n),
            f_sizes: stacked([a_sizes].iter().chain(&c_sizes), n),
            g: stacked([beside_each(&b, n)].iter().chain(&d), width),
            g_sizes: stacked([beside_each(&b_sizes, n)].iter().chain(&d_sizes), width),
            inputs: beside_each(&inputs, n),
            forcing,
            parts,
            outs,
            ins,
            terms: data.region.d.max(m) + 2,
            lift: data.lift,
        };
        if let Some(im) = turn {
            made.turn(data, im, pieces.len());
        }
        made
    }

    /// The same in real numbers for a gain with an imaginary part.
    fn turn(&mut self, data: &Uncertain, im: &Matrix, parts: usize) {
        let n = self.n;
        let (mut rows, mut sizes) = (Vec::new(), Vec::new());
        rows.push(&data.b * im);
        sizes.push(absolute(&data.b) * absolute(im));
        for piece in &data.pieces[..parts] {
            let through = piece.w.subcols(n, data.m).to_owned();
            rows.push(&through * im);
            sizes.push(absolute(&through) * absolute(im));
        }
        rows.push(Mat::zeros(self.outs.len(), n));
        sizes.push(Mat::zeros(self.outs.len(), n));
        // the rows of both copies: states, parts, channels
        let (above, middle) = (n, self.parts.len());
        let order = |a: Matrix| {
            let half = a.nrows() / 2;
            let cuts = [(0, above), (above, middle), (above + middle, half - above - middle)];
            let each = cuts.iter().flat_map(|(from, count)| {
                [a.subrows(*from, *count).to_owned(), a.subrows(half + from, *count).to_owned()]
            });
            stacked(&gathered(each), a.ncols())
        };
        let im_sizes = stacked(&sizes, n);
        self.f = order(beside(&self.f, &stacked(&rows, n)));
        self.f_sizes = absolute(&order(beside(&self.f_sizes, &im_sizes)));
        self.g = order(twice(&self.g));
        self.g_sizes = order(twice(&self.g_sizes));
        (self.inputs, self.forcing) = (twice(&self.inputs), twice(&self.forcing));
        self.n = 2 * n;
        for all in [&mut self.outs, &mut self.ins] {
            let more = all.clone();
            all.extend(more);
        }
        let more = self.parts.clone();
        self.parts.extend(more);
    }

    pub fn a(&self) -> Matrix {
        self.f.subrows(0, self.n).to_owned()
    }

    /// `T^(-1/2) C`, the rows of the parts scaled, those of channels not.
    pub fn c(&self) -> Matrix {
        let count = self.parts.len();
        Mat::from_fn(self.f.nrows() - self.n, self.n, |i, j| self.f[(self.n + i, j)] / self.scale(i, count))
    }

    fn scale(&self, i: usize, count: usize) -> f64 {
        if i < count { self.parts[i].sqrt() } else { 1.0 }
    }

    /// The rows of the parts in `C`.
    pub fn count(&self) -> usize {
        self.parts.len()
    }

    pub fn b(&self) -> Matrix {
        self.g.subrows(0, self.n).to_owned()
    }

    /// `T^(-1/2) D`, as `c`.
    pub fn d(&self) -> Matrix {
        let count = self.parts.len();
        Mat::from_fn(self.g.nrows() - self.n, self.g.ncols(), |i, j| self.g[(self.n + i, j)] / self.scale(i, count))
    }

    /// R, `Q = R R'`, of the proof for channels with these `gammas` and multipliers `t`, `X` and `lambda`; verified. It
    /// is solved for blocks that are larger by `slack`.
    pub fn proof(&self, gammas: &[f64], t: &[f64], (x, lambda): (Option<&Matrix>, f64), slack: f64) -> Option<Matrix> {
        let (outs, count) = (self.f.nrows() - self.n, self.parts.len());
        let level = |i: usize| if i < count { 1.0 } else { t[self.outs[i - count]] };
        let weight = |j: usize| gammas[self.ins[j]] * t[self.ins[j]].sqrt();
        let sound = gammas.iter().all(|v| *v >= 0.0 && v.is_finite()) && t.iter().all(|v| *v > 0.0 && v.is_finite());
        if !sound {
            return None;
        }
        let (c, d, b) = (self.c(), self.d(), self.b());
        let c = Mat::from_fn(outs, self.n, |i, j| c[(i, j)] / level(i).sqrt());
        let d = Mat::from_fn(outs, self.ins.len(), |i, j| slack * d[(i, j)] * weight(j) / level(i).sqrt());
        let b = Mat::from_fn(self.n, self.ins.len(), |i, j| slack * b[(i, j)] * weight(j));
        // without feedthrough: A + B D' R^-1 C, B (I - D'D)^-1 B', C' R^-1 C, R = I - D D'
        let lower = |a: &Matrix| {
            (Mat::<f64>::identity(a.nrows(), a.nrows()) - a * a.transpose())
                .llt(Side::Lower)
                .ok()
                .map(|l| l.L().to_owned())
        };
        let solved = |l: &Matrix, a: &Matrix| {
            let mut a = a.clone();
            solve_lower_triangular_in_place(l.as_ref(), a.as_mut(), Par::Seq);
            a
        };
        let out = lower(&d)?;
        let c_own = solved(&out, &c);
        let own = lower(&d.transpose().to_owned())?;
        let b_own = solved(&own, &b.transpose().to_owned());
        let a = self.a() + &b * (solved(&out, &d).transpose() * &c_own);
        let wide = &self.inputs * faer::Scale(slack);
        let mut h = &wide * wide.transpose() + b_own.transpose() * &b_own;
        if let Some(x) = x {
            h += x * faer::Scale(slack * slack);
        }
        let root = least(&a, Some(&c_own), &symmetric(&h), lambda, (ROOM * (slack - 1.0), self.lift)).found()?;
        self.verified(&root, gammas, t, (x, lambda)).then_some(root)
    }

    /// Whether all members are stable, without channels.
    pub fn alone(&self) -> bool {
        [1.2, 1.02, 1.002, 1.0002].iter().any(|slack| self.proof(&[], &[], (None, 1.0), *slack).is_some())
    }

    /// Whether `Q = R R'` is a proof.
    pub fn verified(&self, root: &Matrix, gammas: &[f64], t: &[f64], (x, lambda): (Option<&Matrix>, f64)) -> bool {
        let sound = gammas.iter().all(|v| *v >= 0.0 && v.is_finite()) && t.iter().all(|v| *v > 0.0 && v.is_finite());
        if !(sound && finite(root) && gammas.len() == t.len() && root.nrows() == self.n) {
            return false;
        }
        let weight = |j: usize| gammas[self.ins[j]] * t[self.ins[j]].sqrt();
        let weighted = |a: &Matrix| Mat::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)] * weight(j));
        let mut levels = self.parts.clone();
        levels.extend(self.outs.iter().map(|j| t[*j]));
        let claim = Claim { root, x, alpha: 1.0, lambda, by: 1.0 };
        holds(&Judged {
            f: &self.f,
            sizes: &self.f_sizes,
            beside: Some((&weighted(&self.g), &weighted(&self.g_sizes))),
            forcing: &self.forcing,
            levels: &levels,
            terms: self.terms,
            claim: &claim,
        })
    }
}
