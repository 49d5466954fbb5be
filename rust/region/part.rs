//! One part of a region: `(Theta - C) V (Theta - C)' <= factor S` for some rows and columns of Theta.

use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::identify::{Fitted, Symmetric, spectral_norm};
use crate::matrix::MatrixView;
use crate::memory::{checked_len, try_copy, try_zeros};

pub(super) const WHAT: &str = "a region of models";

/// `a b`, where 0 times infinity is 0: nothing to bound.
pub(crate) fn times(a: f64, b: f64) -> f64 {
    if a == 0.0 || b == 0.0 { 0.0 } else { a * b }
}

/// The ratio below which the missing directions are known to fewer than half of the digits.
pub(super) const TRUSTED: f64 = 1e-8;

/// See [`Part::around`].
const WIDER: f64 = 10.0;

/// What a [`Part`] is made of.
#[derive(Debug, Clone, Copy)]
pub struct PartOf<'a> {
    /// Rows of Theta, and the columns that are not known in them.
    pub rows: &'a [usize],
    /// See `rows`.
    pub columns: &'a [usize],
    /// `white' white = V^+` (rank, columns).
    pub white: MatrixView<'a>,
    /// `root' root = V` (any, columns).
    pub root: MatrixView<'a>,
    /// The directions of z that the data do not determine, as columns (columns, any), if there are any. Rows that are
    /// rounding are 0.
    pub missing: Option<MatrixView<'a>>,
    /// Smallest over largest singular value of the data with columns of unit length.
    pub ratio: f64,
    /// `S` (rows, rows).
    pub shape: MatrixView<'a>,
    /// The factor; may be infinite.
    pub factor: f64,
}

/// A bound of some rows of `D = Theta - C`. By Cauchy and Schwarz, for all z at once, also for z chosen after the data,
///
/// ```text
/// ||D z|| <= sqrt(factor ||S||) ||z||_(V^-1),    |D z|_i <= sqrt(factor S_ii) ||z||_(V^-1),
/// ```
///
/// where the length of z is infinite off the range of V.
#[derive(Debug, Clone)]
pub struct Part {
    pub(crate) rows: Vec<usize>,
    pub(crate) columns: Vec<usize>,
    pub(crate) white: Vec<f64>,
    pub(crate) root: Vec<f64>,
    pub(crate) missing: Vec<f64>,
    pub(crate) ratio: f64,
    pub(crate) shape: Vec<f64>,
    pub(crate) factor: f64,
    radius: f64,
    deviations: Vec<f64>,
}

/// The directions, as columns of so many entries.
pub(super) fn directions(missing: &[f64], entries: usize) -> Option<MatrixView<'_>> {
    (!missing.is_empty()).then(|| MatrixView::of(missing, missing.len() / entries))
}

impl Part {
    /// # Errors
    /// [`Error::Shape`], [`Error::Value`] for a factor that is no number >= 0, [`Error::Overflow`] for a shape that is
    /// not finite, [`Error::Memory`].
    pub fn new(of: PartOf<'_>) -> Result<Self> {
        let (n, d) = (of.rows.len(), of.columns.len());
        let shape = of.shape.sized("S", n, n)?;
        let white = of.white.wide("white", d)?;
        let root = of.root.wide("root", d)?;
        let missing = of.missing.map(|of| of.high("missing", d)).transpose()?.unwrap_or_default();
        if of.factor.is_nan() || of.factor < 0.0 {
            return Err(Error::Value { name: "factor", expected: "at least 0", found: of.factor.to_string() });
        }
        let finite = of.factor.is_finite();
        let radius = if finite { (of.factor * spectral_norm(&shape, n, n)?).sqrt() } else { f64::INFINITY };
        let mut deviations = try_zeros(WHAT, n)?;
        for (i, to) in deviations.iter_mut().enumerate() {
            *to = if finite { (of.factor * shape[i * (n + 1)].max(0.0)).sqrt() } else { f64::INFINITY };
        }
        Ok(Self {
            rows: try_copy(WHAT, of.rows)?,
            columns: try_copy(WHAT, of.columns)?,
            white: try_copy(WHAT, &white)?,
            root: try_copy(WHAT, &root)?,
            missing: try_copy(WHAT, &missing)?,
            ratio: of.ratio,
            shape: try_copy(WHAT, &shape)?,
            factor: of.factor,
            radius,
            deviations,
        })
    }

    /// The part around least squares, widened by its rounding.
    ///
    /// With rows wrong by r, in the data and in D, `||l' D V^(1/2)||` is at most
    /// `sqrt(factor) (||l' E|| + |l|' r) + |l|' r`, and `(|l|' r)^2 <= n l' diag(r^2) l`. The factor `WIDER` takes the
    /// product of both terms, up to `2 / WIDER^2` of the first one.
    ///
    /// # Errors
    /// As [`Part::new`].
    pub fn around(f: &Fitted, shape: &[f64], factor: f64) -> Result<Self> {
        Self::within(f, &f.missing, shape, factor)
    }

    /// The same with other missing directions.
    pub(super) fn within(f: &Fitted, missing: &[f64], shape: &[f64], factor: f64) -> Result<Self> {
        let (n, mut wide) = (f.rows.len(), try_copy(WHAT, shape)?);
        if 0.0 < factor && factor.is_finite() {
            let rounding = |r: f64| WIDER * (1.0 + 1.0 / factor.sqrt()) * r;
            wide.iter_mut().step_by(n + 1).zip(&f.rounding).for_each(|(v, r)| *v += n as f64 * rounding(*r).powi(2));
        }
        let (rows, columns, shape) = (&f.rows, &f.columns, MatrixView::of(&wide, n));
        let [white, root] = [&f.white, &f.root].map(|of| MatrixView::of(of, columns.len()));
        let missing = directions(missing, columns.len());
        Self::new(PartOf { rows, columns, white, root, missing, ratio: f.ratio, shape, factor })
    }

    /// What it is made of.
    #[must_use]
    pub fn of(&self) -> PartOf<'_> {
        PartOf {
            rows: &self.rows,
            columns: &self.columns,
            white: MatrixView::of(&self.white, self.columns.len()),
            root: MatrixView::of(&self.root, self.columns.len()),
            missing: directions(&self.missing, self.columns.len()),
            ratio: self.ratio,
            shape: MatrixView::of(&self.shape, self.rows.len()),
            factor: self.factor,
        }
    }

    /// `sqrt(factor ||S||)`.
    #[must_use]
    pub const fn radius(&self) -> f64 {
        self.radius
    }

    /// `sqrt(factor S_ii)`, for each row.
    #[must_use]
    pub fn deviations(&self) -> &[f64] {
        &self.deviations
    }

    /// The rank of V.
    #[must_use]
    pub fn rank(&self) -> usize {
        self.white.len().checked_div(self.columns.len()).unwrap_or(0)
    }

    /// `||z||` in the norm of `V^+`, infinite where the data do not determine `Theta z`; of the entries `columns` of
    /// `z`.
    ///
    /// Each missing direction is judged against the size of what is added up in it. Rounding turns these directions by
    /// `eps / ratio` (Wedin 1972). Where that is more than half of the digits, only a z that fits them as well as at
    /// `TRUSTED` counts as determined: in doubt the length is infinite.
    #[must_use]
    pub fn length(&self, z: &[f64]) -> f64 {
        let largest = self.columns.iter().map(|&j| z[j].abs()).fold(0.0, f64::max);
        if largest == 0.0 {
            return 0.0;
        }
        let scaled = || self.columns.iter().map(|&j| z[j] / largest); // no square overflows
        let tolerance = self.roundoffs() * f64::EPSILON;
        let directions = self.missing.len() / self.columns.len();
        for q in 0..directions {
            let terms = || self.missing.iter().skip(q).step_by(directions).zip(scaled()).map(|(m, z)| m * z);
            if terms().sum::<f64>().abs() > tolerance * terms().map(f64::abs).sum::<f64>() {
                return f64::INFINITY;
            }
        }
        let white = self.white.chunks_exact(self.columns.len());
        let size = norm(white.map(|row| row.iter().zip(scaled()).map(|(w, z)| w * z).sum::<f64>()));
        largest * size
    }

    /// In how many roundoffs of its terms a missing direction is absent.
    pub(crate) fn roundoffs(&self) -> f64 {
        100.0 * self.columns.len() as f64 / self.ratio.max(TRUSTED)
    }

    /// The length of the unit vector of an entry of `columns`, by its place there.
    pub(crate) fn unit_length(&self, at: usize) -> f64 {
        let width = self.columns.len();
        let directions = self.missing.len() / width;
        // a unit vector is determined where it has no part at all in the missing directions
        if self.missing[at * directions..(at + 1) * directions].iter().any(|m| *m != 0.0) {
            return f64::INFINITY;
        }
        norm(self.white.chunks_exact(width).map(|row| row[at]))
    }

    /// `sup ||v||_(V^-1)` over `||v||_2 = 1` in these columns of Theta: the norm of those of `white`.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn reach(&self, from: usize, to: usize) -> Result<f64> {
        let width = self.columns.len();
        let inside = || (0..width).filter(|&at| (from..to).contains(&self.columns[at]));
        let count = inside().count();
        if count == 0 {
            return Ok(0.0);
        }
        if inside().any(|at| self.unit_length(at).is_infinite()) {
            return Ok(f64::INFINITY);
        }
        let mut some = try_zeros(WHAT, checked_len(WHAT, self.rank(), count)?)?;
        for (to, row) in some.chunks_exact_mut(count).zip(self.white.chunks_exact(width)) {
            to.iter_mut().zip(inside()).for_each(|(to, at)| *to = row[at]);
        }
        spectral_norm(&some, self.rank(), count)
    }

    /// Whether this difference (n, d) from the centre is in the part: `X X' <= factor S` for `X = D V^(1/2)`.
    ///
    /// In units of the rows, those of S or of the rounding of X, so that neither units nor a singular S decide.
    pub(crate) fn contains(&self, difference: &[f64], d: usize) -> Result<bool> {
        if self.factor.is_infinite() {
            return Ok(true);
        }
        let (n, width) = (self.rows.len(), self.columns.len());
        if width == 0 {
            return Ok(true);
        }
        let count = self.root.len() / width;
        let terms = (count + width) as f64;
        let mut x = try_zeros::<f64>(WHAT, checked_len(WHAT, n, count)?)?;
        let [mut sizes, mut rounding] = [try_zeros::<f64>(WHAT, n)?, try_zeros::<f64>(WHAT, n)?];
        for i in 0..n {
            let inside = || self.columns.iter().map(|&j| difference[self.rows[i] * d + j]);
            let x = &mut x[i * count..(i + 1) * count];
            for (x, row) in x.iter_mut().zip(self.root.chunks_exact(width)) {
                *x = inside().zip(row).map(|(a, b)| a * b).sum();
            }
            let column = |at: usize| norm(self.root.iter().copied().skip(at).step_by(width));
            rounding[i] = terms * f64::EPSILON * inside().enumerate().map(|(at, a)| a.abs() * column(at)).sum::<f64>();
            sizes[i] = self.deviations[i].hypot(rounding[i]);
            if sizes[i] == 0.0 {
                if x.iter().any(|x| *x != 0.0) {
                    return Ok(false);
                }
                sizes[i] = 1.0;
            }
            x.iter_mut().for_each(|x| *x /= sizes[i]);
            if !x.iter().all(|x| x.abs() <= 2.0) {
                return Ok(false);
            }
        }
        // room = factor S / (size_i size_j) + n diag((rounding / size)^2) - X X'
        let mut room = Symmetric::new(n)?;
        for i in 0..n {
            for j in 0..=i {
                let row = |i: usize| &x[i * count..(i + 1) * count];
                let square: f64 = row(i).iter().zip(row(j)).map(|(a, b)| a * b).sum();
                room.matrix[i * n + j] = self.factor * self.shape[i * n + j] / sizes[i] / sizes[j] - square;
            }
            room.matrix[i * (n + 1)] += n as f64 * (rounding[i] / sizes[i]).powi(2);
        }
        if !room.matrix.iter().all(|v| v.is_finite()) {
            return Ok(false);
        }
        // entries of up to 1, wrong by the rounding of `terms` products, and the eigenvalues by n
        let least = room.eigenvalues()?.iter().copied().fold(f64::INFINITY, f64::min);
        Ok(least >= -(n as f64) * (terms + n as f64) * f64::EPSILON)
    }
}
