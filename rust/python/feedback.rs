//! Loops that are proved for a region, and gains.

use std::sync::Arc;

use numpy::{Complex64, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, array2, slice, view};
use super::region::PyRegion;
use super::run::{UNTIL_STOPPED, run};
use crate::Error;
use crate::feedback::{self, Filters, Gain, Keeper, Loop, Misfit, Preview, Recorder, Run};
use crate::memory::{try_collect, try_copy};
use crate::parallel::Stop;

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;
type Array1<'py> = Bound<'py, PyArray1<f64>>;
type Array2<'py> = Bound<'py, PyArray2<f64>>;

const WHAT: &str = "the certificate of a feedback";

fn recorded<'a>(given: Option<&'a (Matrix<'_>, Matrix<'_>)>) -> PyResult<Option<Recorder<'a>>> {
    given.map(|(next, reads)| Ok(Recorder { next: slice("N", next)?, reads: slice("G", reads)? })).transpose()
}

/// A gain and a region, with what is proved.
#[pyclass(frozen, module = "stochens_rs._core", name = "Feedback")]
pub(super) struct PyFeedback {
    of: Arc<Loop>,
    n: usize,
    m: usize,
}

#[pymethods]
impl PyFeedback {
    /// Of data in doubt nothing is certified.
    #[new]
    #[pyo3(signature = (region, gain, doubted=false, misfit=None))]
    fn new(
        py: Python<'_>,
        region: &Bound<'_, PyRegion>,
        gain: Matrix<'_>,
        doubted: bool,
        misfit: Option<(Matrix<'_>, Matrix<'_>, f64)>,
    ) -> PyResult<Self> {
        let (region, (m, n)) = (&region.get().0, gain.as_array().dim());
        let gain = view("K", &gain)?;
        let mut misfits = Vec::new();
        if let Some((direction, of, most)) = &misfit {
            let direction = try_copy(WHAT, slice("direction", direction)?)?;
            misfits.push(Misfit { direction, of: try_copy(WHAT, slice("of", of)?)?, most: *most });
        }
        let of = run(py, UNTIL_STOPPED, |stop| Loop::beside(region, misfits, gain, stop))?;
        Ok(Self { of: Arc::new(if doubted { of.doubted() } else { of }), n, m })
    }

    /// The loop of more states, which follow those of this one and do not act on them.
    fn behind(&self, py: Python<'_>, region: &Bound<'_, PyRegion>, gain: Matrix<'_>) -> PyResult<Self> {
        let (region, (m, n)) = (&region.get().0, gain.as_array().dim());
        let gain = view("K", &gain)?;
        let of = run(py, UNTIL_STOPPED, |stop| self.of.behind(region, gain, stop))?;
        Ok(Self { of: Arc::new(of), n, m })
    }

    #[getter]
    fn status(&self) -> &'static str {
        self.of.certificate().status.as_str()
    }

    /// Proved upper and unproved lower bound of `rho g`, and the spectral radius of the centre.
    #[getter]
    fn sizes(&self) -> (f64, f64, f64) {
        let found = self.of.certificate();
        (found.norm, found.least, found.radius)
    }

    #[getter]
    fn proof<'py>(&self, py: Python<'py>) -> PyResult<Option<Array2<'py>>> {
        let proof = self.of.certificate().proof.as_deref();
        proof.map(|q| array2(py, try_copy(WHAT, q)?, self.n, self.n)).transpose()
    }

    #[getter]
    fn multipliers<'py>(&self, py: Python<'py>) -> PyResult<Array1<'py>> {
        array1(py, try_copy(WHAT, &self.of.certificate().multipliers)?)
    }

    #[getter]
    fn member<'py>(&self, py: Python<'py>) -> PyResult<Option<Array2<'py>>> {
        let member = self.of.certificate().member.as_deref();
        member.map(|theta| array2(py, try_copy(WHAT, theta)?, self.n, theta.len() / self.n)).transpose()
    }

    /// R, for `Y = R R'` with `A_G Y A_G' / lambda + X <= Y` for all members, proved; with a `slack` that of the least
    /// one for larger sides.
    #[pyo3(signature = (x, alpha, lambda_, slack=None))]
    fn invariant<'py>(
        &self,
        py: Python<'py>,
        x: Matrix<'_>,
        alpha: f64,
        lambda_: f64,
        slack: Option<f64>,
    ) -> PyResult<Option<Array2<'py>>> {
        let found = self.of.invariant(slice("X", &x)?, alpha, lambda_, slack)?;
        found.map(|y| array2(py, y, self.n, self.n)).transpose()
    }

    fn verified(
        &self,
        root: Matrix<'_>,
        x: Matrix<'_>,
        alpha: f64,
        lambda_: f64,
        multipliers: Vector<'_>,
    ) -> PyResult<bool> {
        let (root, x, multipliers) = (slice("R", &root)?, slice("X", &x)?, slice("multipliers", &multipliers)?);
        Ok(self.of.verified(root, x, alpha, lambda_, multipliers)?)
    }

    /// `(nominal, model, start, radii, noise, noise_radius, later, reach)`.
    #[expect(clippy::type_complexity, clippy::too_many_arguments, reason = "the fields of a tube and of a run")]
    #[pyo3(signature = (x0, steps, plan, start, noise, rest=None))]
    fn tube<'py>(
        &self,
        py: Python<'py>,
        x0: Vector<'_>,
        steps: usize,
        plan: Matrix<'_>,
        start: f64,
        noise: Option<(Matrix<'_>, f64)>,
        rest: Option<(Vector<'_>, Vector<'_>)>,
    ) -> PyResult<(Array2<'py>, Array2<'py>, Array2<'py>, Array1<'py>, Array1<'py>, f64, Array1<'py>, Array1<'py>)>
    {
        let noise = match &noise {
            Some((covariance, eps)) => Some((slice("noise", covariance)?, *eps)),
            None => None,
        };
        let rest = match &rest {
            Some((xs, us)) => Some((slice("xs", xs)?, slice("us", us)?)),
            None => None,
        };
        let asked = Run { x0: slice("x0", &x0)?, steps, plan: slice("inputs", &plan)?, start, rest, noise };
        let found = run(py, UNTIL_STOPPED, |stop| self.of.tube(asked, stop))?;
        let table = |values: Vec<f64>| array2(py, values, steps + 1, self.n + self.m);
        Ok((
            table(found.nominal)?,
            table(found.model)?,
            table(found.start)?,
            array1(py, found.radii)?,
            array1(py, found.noise)?,
            found.noise_radius,
            array1(py, found.later)?,
            array1(py, found.reach)?,
        ))
    }

    /// How far states and inputs are at rest from `(xs, us)`, and the states in the 2-norm.
    fn rest<'py>(&self, py: Python<'py>, xs: Vector<'_>, us: Vector<'_>) -> PyResult<(Array1<'py>, f64)> {
        let (rows, radius) = self.of.rest(slice("xs", &xs)?, slice("us", &us)?)?;
        Ok((array1(py, rows)?, radius))
    }

    /// How large a term in the states `e` of `h (x, u)` may be, for all systems and for the centre.
    fn allows(&self, py: Python<'_>, e: Matrix<'_>, h: Matrix<'_>) -> PyResult<(f64, f64)> {
        let (e, h) = (slice("E", &e)?, slice("H", &h)?);
        let found = run(py, UNTIL_STOPPED, |stop| self.of.allows(e, h, stop))?;
        Ok((found.certified, found.nominal))
    }

    /// What the loop stands, certified and of the centre (4 m + 6, 2): for each input the least and largest gain,
    /// phase, disk; then the disk of all, delay, varying delay, readings, bits, share. `recorder` is that of the
    /// controller, if it has one.
    #[pyo3(signature = (recorder=None))]
    fn margins<'py>(&self, py: Python<'py>, recorder: Option<(Matrix<'py>, Matrix<'py>)>) -> PyResult<Array2<'py>> {
        let recorder = recorded(recorder.as_ref())?;
        let found = run(py, UNTIL_STOPPED, |stop| self.of.margins(recorder, stop))?;
        let mut all = Vec::new();
        for ((gain, phase), disk) in found.gains.iter().zip(&found.phases).zip(&found.disks) {
            all.extend([gain[0], gain[1], *phase, *disk]);
        }
        all.extend([found.disk, found.delay, found.varying, found.readings, found.bits, found.share]);
        let values = try_collect(WHAT, all.iter().flat_map(|one| [one.certified, one.nominal]))?;
        array2(py, values, all.len(), 2)
    }

    /// How far states and inputs are moved by the rounding of a computer from those of a loop that is at most `reach`
    /// and asks for inputs that are `apart`; filters are (pole, outputs, count).
    fn rounded<'py>(
        &self,
        py: Python<'py>,
        reach: Vector<'_>,
        apart: Vector<'_>,
        bits: Option<i32>,
        filters: Option<(Option<f64>, usize, usize)>,
    ) -> PyResult<Array1<'py>> {
        let exact = (slice("reach", &reach)?, slice("apart", &apart)?);
        let filters = filters.and_then(|(pole, outputs, count)| pole.map(|pole| Filters { pole, outputs, count }));
        array1(py, run(py, UNTIL_STOPPED, |stop| self.of.rounded(exact, bits, filters, stop))?)
    }

    /// How far states and `K x`, and inputs, are moved by readings that are off by these sizes.
    fn misread<'py>(
        &self,
        py: Python<'py>,
        recorder: Option<(Matrix<'py>, Matrix<'py>)>,
        sizes: Vector<'_>,
    ) -> PyResult<(Array1<'py>, Array1<'py>)> {
        let (recorder, sizes) = (recorded(recorder.as_ref())?, slice("sizes", &sizes)?);
        let (moved, off) = run(py, UNTIL_STOPPED, |stop| self.of.misread(recorder, sizes, stop))?;
        Ok((array1(py, moved)?, array1(py, off)?))
    }

    /// How many times `x0` all systems come to rest from, although the inputs saturate.
    fn attracted(&self, py: Python<'_>, limits: Vector<'_>, x0: Vector<'_>) -> PyResult<f64> {
        let (limits, x0) = (slice("limits", &limits)?, slice("x0", &x0)?);
        run(py, UNTIL_STOPPED, |stop| self.of.attracted(limits, x0, stop))
    }

    fn holds(&self, py: Python<'_>, limits: Vector<'_>, x0: Option<Vector<'_>>) -> PyResult<(f64, Option<f64>)> {
        let (limits, x0) = (slice("limits", &limits)?, x0.as_ref().map(|x0| slice("x0", x0)).transpose()?);
        run(py, UNTIL_STOPPED, |stop| self.of.holds(limits, x0, stop))
    }
}

/// Limits that are kept with a stated probability.
#[pyclass(frozen, module = "stochens_rs._core", name = "Keeper")]
pub(super) struct PyKeeper(Keeper);

/// `(row, step, amount, model, noise)`.
type Short = (usize, usize, f64, f64, f64);

#[pymethods]
impl PyKeeper {
    /// None where nothing is proved; limits `(low, high, below)`.
    #[staticmethod]
    fn of(
        feedback: &Bound<'_, PyFeedback>,
        limits: (Vector<'_>, Vector<'_>, Matrix<'_>),
        covariance: Matrix<'_>,
        eps: f64,
        calls: usize,
    ) -> PyResult<Option<Self>> {
        let (low, high, below) = (slice("low", &limits.0)?, slice("high", &limits.1)?, slice("below", &limits.2)?);
        let covariance = slice("noise", &covariance)?;
        Ok(Keeper::new(Arc::clone(&feedback.get().of), ((low, high), below), covariance, eps, calls)?.map(Self))
    }

    #[getter]
    fn noise<'py>(&self, py: Python<'py>) -> PyResult<Array1<'py>> {
        array1(py, try_copy(WHAT, self.0.noise())?)
    }

    /// What the plan lacks, if it is not accepted, and what the error of the model adds to each row; by the exact first
    /// order, which takes longer, only where that can matter or if `always`.
    fn judge<'py>(
        &self,
        py: Python<'py>,
        x0: Vector<'_>,
        plan: Matrix<'_>,
        always: bool,
    ) -> PyResult<(Option<Short>, Array1<'py>)> {
        let (x0, plan) = (slice("x0", &x0)?, slice("inputs", &plan)?);
        let mut found = self.0.judge(x0, plan, false, &Stop::new())?;
        if found.short.is_some() && (always || !found.surely) {
            // n^2 (n + d) or so for each of some hundred steps
            let cost = 1e3 * (x0.len() as f64).powi(3);
            found = run(py, cost, |stop| self.0.judge(x0, plan, true, stop))?;
        }
        let short = found.short.map(|s| (s.row, s.step, s.amount, s.model, s.noise));
        Ok((short, array1(py, found.model)?))
    }

    /// The input at `x`, `k` steps after the plan began.
    fn follow<'py>(
        &self,
        py: Python<'py>,
        x0: Vector<'_>,
        plan: Matrix<'_>,
        k: usize,
        x: Vector<'_>,
    ) -> PyResult<Array1<'py>> {
        array1(py, self.0.follow(slice("x0", &x0)?, slice("inputs", &plan)?, k, slice("x", &x)?)?)
    }
}

fn complex<'py>(py: Python<'py>, values: &[(f64, f64)]) -> PyResult<Bound<'py, PyArray1<Complex64>>> {
    array1(py, try_collect(WHAT, values.iter().map(|(re, im)| Complex64::new(*re, *im)))?)
}

/// `(K, cost, parameter)`.
type FoundGain<'py> = (Array2<'py>, Option<Array2<'py>>, f64);

fn handed<'py>(py: Python<'py>, found: Gain, n: usize) -> PyResult<FoundGain<'py>> {
    let m = found.gain.len() / n;
    let cost = found.cost.map(|p| array2(py, p, n, n)).transpose()?;
    Ok((array2(py, found.gain, m, n)?, cost, found.parameter))
}

/// What there is no gain for, with the names of the states.
fn named(names: Option<Vec<String>>) -> impl FnOnce(Error) -> Error + Send {
    move |error| match (error, names) {
        (Error::NoGain(cause), Some(names)) => {
            Error::Numerical(cause.in_words(|i| names.get(i).cloned().unwrap_or_default()))
        }
        (error, _) => error,
    }
}

/// The gain of least squares for `A` and `B`; `states` are their names.
#[pyfunction]
#[pyo3(signature = (a, b, q, r, states=None))]
pub(super) fn feedback_gain<'py>(
    py: Python<'py>,
    a: Matrix<'_>,
    b: Matrix<'_>,
    q: Matrix<'_>,
    r: Matrix<'_>,
    states: Option<Vec<String>>,
) -> PyResult<FoundGain<'py>> {
    let (a, b, q, r) = (view("A", &a)?, view("B", &b)?, view("Q", &q)?, view("R", &r)?);
    let found = run(py, UNTIL_STOPPED, |stop| feedback::least_squares(a, b, q, r, stop).map_err(named(states)))?;
    handed(py, found, a.shape().0)
}

/// `(v, way)`: see [`Preview::inputs`].
#[pyfunction]
pub(super) fn preview<'py>(
    py: Python<'py>,
    model: (Matrix<'_>, Matrix<'_>, Matrix<'_>, Matrix<'_>),
    weights: (Matrix<'_>, Matrix<'_>),
    gain: Matrix<'_>,
    path: (Matrix<'_>, Matrix<'_>, Matrix<'_>),
    start: Vector<'_>,
) -> PyResult<(Array2<'py>, Array2<'py>)> {
    let (m, n) = gain.as_array().dim();
    let of = Preview {
        a: slice("A", &model.0)?,
        b: slice("B", &model.1)?,
        c: slice("C", &model.2)?,
        d: slice("D", &model.3)?,
        q: slice("Q", &weights.0)?,
        r: slice("R", &weights.1)?,
        k: slice("K", &gain)?,
    };
    let steps = [slice("x", &path.0)?, slice("u", &path.1)?, slice("w", &path.2)?];
    let start = slice("start", &start)?;
    let (more, way) = run(py, UNTIL_STOPPED, |stop| of.inputs(steps, start, stop))?;
    let h = more.len() / m.max(1);
    Ok((array2(py, more, h, m)?, array2(py, way, h, n)?))
}

/// The eigenvalues of `A + B K`.
#[pyfunction]
pub(super) fn loop_eigenvalues<'py>(
    py: Python<'py>,
    a: Matrix<'_>,
    b: Matrix<'_>,
    k: Matrix<'_>,
) -> PyResult<Bound<'py, PyArray1<Complex64>>> {
    complex(py, &feedback::eigenvalues(view("A", &a)?, view("B", &b)?, view("K", &k)?)?)
}

/// The largest state of a mode that does not decay and that no input is seen to move, and how it grows; of `p` rows by
/// data.
#[pyfunction]
pub(super) fn unmoved(py: Python<'_>, region: &Bound<'_, PyRegion>, p: usize) -> PyResult<Option<(usize, f64)>> {
    let region = &region.get().0;
    run(py, 1e6, |_| feedback::unmoved(region, p))
}

/// The gain with the widest margin in a region.
#[pyfunction]
pub(super) fn widest_gain<'py>(py: Python<'py>, region: &Bound<'_, PyRegion>) -> PyResult<FoundGain<'py>> {
    let region = &region.get().0;
    handed(py, run(py, UNTIL_STOPPED, |stop| feedback::widest(region, stop))?, region.n)
}

/// The gain with the least guaranteed cost in a region; `tau` fixes the multiplier.
#[pyfunction]
#[pyo3(signature = (region, q, r, tau=None, states=None))]
pub(super) fn guaranteed_gain<'py>(
    py: Python<'py>,
    region: &Bound<'_, PyRegion>,
    q: Matrix<'_>,
    r: Matrix<'_>,
    tau: Option<f64>,
    states: Option<Vec<String>>,
) -> PyResult<FoundGain<'py>> {
    let (region, q, r) = (&region.get().0, view("Q", &q)?, view("R", &r)?);
    let found = run(py, UNTIL_STOPPED, |stop| feedback::guaranteed(region, q, r, tau, stop).map_err(named(states)))?;
    handed(py, found, region.n)
}
