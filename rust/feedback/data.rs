//! The exact data of the statements: the centre, and each part as `C + D G W`, in units in which the noise of a state
//! is 1.

use std::ops::Range;

use faer::{Mat, MatRef, Side};

use crate::error::{Error, Result};
use crate::region::Region;
use crate::scaled::nearest_power_of_two;

pub(super) const WHAT: &str = "the certificate of a feedback";
pub(super) type Matrix = Mat<f64>;
/// `lift` of `lemma::least`: where disturbances reach each state, and where states repeat each other.
pub(super) const LIFT: f64 = 1e-14;
pub(super) const REPEATED: f64 = 1e-6;

/// An eigenvalue, singular value or inverse that was not found.
pub(super) fn lost<T>(_: T) -> Error {
    Error::Numerical("a decomposition of a closed loop did not converge".into())
}

pub(super) fn matrix(values: &[f64], rows: usize, cols: usize) -> Matrix {
    MatRef::from_row_major_slice(values, rows, cols).to_owned()
}

/// Row by row.
pub(super) fn entries(a: &Matrix) -> Vec<f64> {
    let mut found = Vec::new();
    (0..a.nrows()).for_each(|i| (0..a.ncols()).for_each(|j| found.push(a[(i, j)])));
    found
}

pub(super) fn filled(count: usize, value: f64) -> Vec<f64> {
    let mut all = Vec::new();
    all.resize(count, value);
    all
}

pub(super) fn gathered<T>(values: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut all = Vec::new();
    all.extend(values);
    all
}

pub(super) fn inverse(units: &[f64]) -> Vec<f64> {
    let mut back = Vec::new();
    back.extend(units.iter().map(|unit| 1.0 / unit));
    back
}

pub(super) fn scaled(a: &Matrix, by: f64) -> Matrix {
    Mat::from_fn(a.nrows(), a.ncols(), |i, j| by * a[(i, j)])
}

/// `diag(left) a diag(right)`.
pub(super) fn in_units(a: &Matrix, left: &[f64], right: &[f64]) -> Matrix {
    Mat::from_fn(a.nrows(), a.ncols(), |i, j| left[i] * a[(i, j)] * right[j])
}

pub(super) fn symmetric(a: &Matrix) -> Matrix {
    Mat::from_fn(a.nrows(), a.ncols(), |i, j| 0.5 * (a[(i, j)] + a[(j, i)]))
}

pub(super) fn absolute(a: &Matrix) -> Matrix {
    Mat::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)].abs())
}

pub(super) fn trace(a: &Matrix) -> f64 {
    (0..a.nrows()).map(|i| a[(i, i)]).sum()
}

pub(super) fn finite(a: &Matrix) -> bool {
    (0..a.ncols()).all(|j| (0..a.nrows()).all(|i| a[(i, j)].is_finite()))
}

/// `a` below `b`.
pub(super) fn stacked<'a>(blocks: impl IntoIterator<Item = &'a Matrix>, cols: usize) -> Matrix {
    let mut all = Mat::zeros(0, cols);
    for block in blocks {
        let above = all.nrows();
        all.resize_with(above + block.nrows(), cols, |i, j| block[(i - above, j)]);
    }
    all
}

/// The largest eigenvalue of a symmetric matrix.
pub(super) fn largest(a: &Matrix) -> Result<f64> {
    let unit = size_of(a);
    let found = scaled(a, 1.0 / unit).self_adjoint_eigenvalues(Side::Lower).map_err(lost)?;
    Ok(unit * found.last().copied().unwrap_or(0.0).max(0.0))
}

/// The power of 2 next to the largest entry: decompositions of what is nearly 0 do not converge.
pub(super) fn size_of(a: &Matrix) -> f64 {
    nearest_power_of_two(a.norm_max())
}

/// `D` with `D D' = S`; negative eigenvalues are rounding.
pub(super) fn root(s: &Matrix) -> Result<Matrix> {
    let found = s.self_adjoint_eigen(Side::Lower).map_err(lost)?;
    let (values, vectors) = (found.S().column_vector(), found.U());
    Ok(Mat::from_fn(s.nrows(), s.nrows(), |i, j| vectors[(i, j)] * values[j].max(0.0).sqrt()))
}

/// One part of the region.
#[derive(Debug)]
pub(super) struct Piece {
    pub rows: Vec<usize>,
    /// `sqrt(factor)`, with room for the rounding of the fit, at most the Frobenius radius.
    pub rho: f64,
    /// `S` and `D`, at the rows of the part.
    pub s: Matrix,
    pub root: Matrix,
    /// `W` (rank, d), 0 in known columns.
    pub w: Matrix,
}

/// The units of states whose rows are known, so that `W` has columns of about the size of those of other states; of a
/// state that is not in z those of the next one.
fn known_units(region: &Region, unit: &mut [f64]) {
    let (mut sizes, mut unknown) = (Vec::new(), Vec::new());
    sizes.resize(region.n, 0.0f64);
    unknown.resize(region.n, false);
    for part in &region.parts {
        for row in part.white.chunks_exact(part.columns.len().max(1)) {
            let inside = part.columns.iter().zip(row).filter(|(j, _)| **j < region.n);
            inside.for_each(|(j, value)| sizes[*j] = sizes[*j].hypot(*value));
        }
        part.rows.iter().for_each(|i| unknown[*i] = true);
    }
    let level = (0..region.n).filter(|i| unknown[*i]).map(|i| unit[i] * sizes[i]).fold(0.0, f64::max);
    let mut last = None;
    for i in (0..region.n).rev() {
        if sizes[i] > 0.0 {
            last = Some(level / sizes[i]).filter(|size| *size > 0.0 && size.is_finite());
        }
        if let (false, Some(size)) = (unknown[i], last) {
            unit[i] = nearest_power_of_two(size);
        }
    }
}

/// A region in these units: `x = diag(unit) x_own`, powers of 2, so that nothing is rounded.
#[derive(Debug)]
pub(super) struct Uncertain {
    pub n: usize,
    pub m: usize,
    pub unit: Vec<f64>,
    pub a: Matrix,
    pub b: Matrix,
    /// The offset (n, 1), if there is one.
    pub c: Option<Matrix>,
    pub pieces: Vec<Piece>,
    /// Bound of `||G||_F`.
    pub phi: f64,
    pub region: Region,
    pub misfits: Vec<Misfit>,
    /// See `lemma::least`.
    pub lift: f64,
    /// Rows of A and B that are of `u - K x` in place of u, K in the units of the data: nothing of x cancels in them.
    pub followed: Option<(Range<usize>, Matrix)>,
}

/// A term `f(z)`, `||f(z)|| <= most ||z||`, `z = of (x, u)`, that is added to the states along `direction`: any
/// function, also of the step. In the units of the data.
#[derive(Debug, Clone)]
pub struct Misfit {
    /// (n, k), row by row.
    pub direction: Vec<f64>,
    /// (l, n + m), row by row.
    pub of: Vec<f64>,
    /// The declared size.
    pub most: f64,
}

impl Uncertain {
    pub fn new(region: &Region) -> Result<Self> {
        Self::beside(region, Vec::new())
    }

    /// With terms that are declared beside the region: parts of their own, of all rows, that change from step to step.
    pub fn beside(region: &Region, misfits: Vec<Misfit>) -> Result<Self> {
        let (n, m, d) = (region.n, region.m, region.d);
        let centre = matrix(&region.centre, n, d);
        let mut unit = filled(n, 1.0);
        for part in &region.parts {
            part.rows.iter().zip(part.deviations()).for_each(|(i, size)| unit[*i] = nearest_power_of_two(*size));
        }
        known_units(region, &mut unit);
        let back = |i: usize| 1.0 / unit[i];
        let mut pieces = Vec::new();
        let phi = region.frobenius();
        for part in &region.parts {
            let (rows, width) = (part.rows.clone(), part.columns.len());
            if width == 0 {
                continue;
            }
            // the fit is rounded too: relatively by about d eps / ratio
            let wider = 1.0 + 1e-8 + 100.0 * d as f64 * f64::EPSILON / part.ratio.max(f64::MIN_POSITIVE);
            let shape = |i: usize, j: usize| {
                let (i, j) = (i.max(j), i.min(j));
                part.shape[i * rows.len() + j] * back(rows[i]) * back(rows[j])
            };
            let s = Mat::from_fn(rows.len(), rows.len(), shape);
            let mut w = Mat::zeros(part.rank(), d);
            for (i, row) in part.white.chunks_exact(width).enumerate() {
                for (value, &j) in row.iter().zip(&part.columns) {
                    w[(i, j)] = value * unit.get(j).copied().unwrap_or(1.0);
                }
            }
            let (rho, root) = (part.factor.sqrt().min(phi) * wider, if finite(&s) { root(&s)? } else { s.clone() });
            pieces.push(Piece { rows, rho, s, root, w });
        }
        let a = Mat::from_fn(n, n, |i, j| back(i) * centre[(i, j)] * unit[j]);
        let b = Mat::from_fn(n, m, |i, j| back(i) * centre[(i, n + j)]);
        let c = region.offset().then(|| Mat::from_fn(n, 1, |i, _| back(i) * centre[(i, n + m)]));
        for one in &misfits {
            let (k, l) = (one.direction.len() / n, one.of.len() / (n + m));
            if one.direction.len() != n * k
                || one.of.len() != l * (n + m)
                || k * l == 0
                || one.most.is_nan()
                || one.most < 0.0
            {
                let (expected, found) = (format!("{n} rows, and {} columns", n + m), "others".into());
                return Err(Error::Shape { name: "misfit", expected, found });
            }
            let e = Mat::from_fn(n, k, |i, j| back(i) * one.direction[i * k + j]);
            let s = symmetric(&(&e * e.transpose()));
            let own = |i: usize, j: usize| one.of[i * (n + m) + j] * unit.get(j).copied().unwrap_or(1.0);
            let w = Mat::from_fn(l, d, |i, j| if j < n + m { own(i, j) } else { 0.0 });
            let mut rows = Vec::new();
            rows.extend(0..n);
            // the product E E' is rounded
            let rho = one.most * (1.0 + 1e-12);
            pieces.push(Piece { rows, rho, root: root(&s)?, s, w });
        }
        Ok(Self {
            n,
            m,
            unit,
            a,
            b,
            c,
            pieces,
            phi: phi * (1.0 + 1e-8),
            region: region.clone(),
            misfits,
            lift: LIFT,
            followed: None,
        })
    }

    /// The misfits of a plant with `more` states below.
    pub fn later_misfits(&self, more: usize) -> Vec<Misfit> {
        let (n, m) = (self.n, self.m);
        let mut all = Vec::new();
        for one in &self.misfits {
            let mut direction = one.direction.clone();
            direction.resize(direction.len() + more * (direction.len() / n), 0.0);
            let mut of = Vec::new();
            for row in one.of.chunks_exact(n + m) {
                of.extend_from_slice(&row[..n]);
                of.resize(of.len() + more, 0.0);
                of.extend_from_slice(&row[n..]);
            }
            all.push(Misfit { direction, of, most: one.most });
        }
        all
    }

    /// `A + B K` of a gain, and bounds of the sums of absolute values in each entry.
    pub fn around(&self, k: &Matrix) -> (Matrix, Matrix) {
        let (mut a, mut sizes) = (&self.a + &self.b * k, absolute(&self.a) + absolute(&self.b) * absolute(k));
        if let Some((rows, asked)) = &self.followed {
            let off = Mat::from_fn(self.m, self.n, |i, j| k[(i, j)] - asked[(i, j)] * self.unit[j]);
            let (more, more_sizes) = (&self.b * &off, absolute(&self.b) * absolute(&off));
            for i in rows.clone() {
                for j in 0..self.n {
                    a[(i, j)] = self.a[(i, j)] + more[(i, j)];
                    sizes[(i, j)] = self.a[(i, j)].abs() + more_sizes[(i, j)];
                }
            }
        }
        (a, sizes)
    }

    /// `1 / unit`.
    pub fn back(&self) -> Vec<f64> {
        inverse(&self.unit)
    }

    pub fn ones(&self, count: usize) -> Vec<f64> {
        filled(count, 1.0)
    }

    /// `[I; K; 0]` (d, n).
    pub fn joined(&self, k: &Matrix) -> Matrix {
        let n = self.n;
        Mat::from_fn(self.region.d, n, |i, j| {
            if i < n {
                f64::from(u8::from(i == j))
            } else if i < n + self.m {
                k[(i - n, j)]
            } else {
                0.0
            }
        })
    }

    /// Whether the data determine `Theta [I; K]`, and the radius is finite.
    pub fn determines(&self, k: &Matrix) -> bool {
        let (n, joined) = (self.n, self.joined(k));
        let column = |j: usize| {
            let mut z = Vec::new();
            (0..self.region.d).for_each(|i| z.push(joined[(i, j)] * self.unit.get(i).copied().unwrap_or(1.0)));
            z
        };
        let finite = self.pieces.iter().all(|piece| piece.rho.is_finite());
        finite && (0..n).all(|j| self.region.parts.iter().all(|part| part.length(&column(j)).is_finite()))
    }

    /// Whether the length of `z`, in the units of the data, is finite in all parts.
    pub fn determined(&self, z: &[f64]) -> bool {
        self.region.parts.iter().all(|part| part.length(z).is_finite())
    }
}

/// The loop of a gain around the centre.
#[derive(Debug)]
pub(super) struct Closed {
    /// The gain in these units (m, n), and `A + B K`.
    pub k: Matrix,
    pub a0: Matrix,
    /// `W [I; K]` of each part.
    pub e: Vec<Matrix>,
    /// The multiplier of each part.
    pub t: Vec<f64>,
}

impl Closed {
    pub fn new(data: &Uncertain, k: Matrix) -> Self {
        let joined = data.joined(&k);
        let (mut e, mut t) = (Vec::new(), Vec::new());
        for piece in &data.pieces {
            e.push(&piece.w * &joined);
            t.push(1.0);
        }
        Self { a0: data.around(&k).0, k, e, t }
    }

    /// `T^(-1/2) E` of all parts (R, n).
    pub fn outputs(&self) -> Matrix {
        let mut blocks = Vec::new();
        self.e.iter().zip(&self.t).for_each(|(e, t)| blocks.push(scaled(e, 1.0 / t.sqrt())));
        stacked(&blocks, self.a0.ncols())
    }

    /// `rho D T^(1/2)` of all parts (n, R).
    pub fn inputs(&self, data: &Uncertain) -> Matrix {
        let mut all = Mat::zeros(data.n, 0);
        for (piece, t) in data.pieces.iter().zip(&self.t) {
            let before = all.ncols();
            all.resize_with(data.n, before + piece.rows.len(), |_, _| 0.0);
            for (i, row) in piece.rows.iter().enumerate() {
                for j in 0..piece.rows.len() {
                    all[(*row, before + j)] = piece.rho * t.sqrt() * piece.root[(i, j)];
                }
            }
        }
        all
    }
}
