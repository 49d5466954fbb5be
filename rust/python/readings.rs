//! Loops from readings: the window, the gate, and what is learned of a bias.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{Tables, array1, array2, named, slice, view};
use super::outputs::with_noise;
use super::region::PyRegion;
use super::run::run;
use super::shared::Shared;
use super::window::PyWindow;
use crate::memory::{try_collect, try_copy};
use crate::region::{Aim, Bias, Gate, Readings};
use crate::window::{Contents, Filter};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;
type Row<'py> = Bound<'py, PyArray1<f64>>;
/// What a bias adds to the inputs that hold the set point (m, p), these inputs, and their limits low and high.
type Aimed<'py> = (Matrix<'py>, Vector<'py>, Vector<'py>, Vector<'py>);
type Made<'py> = Bound<'py, PyArray2<f64>>;
/// What was predicted, the bias, how far off, whether believed, what follows ("lost", "waits" or "runs"), x, and
/// whether all was read.
type Found<'py> = (Option<Row<'py>>, Row<'py>, f64, bool, &'static str, Row<'py>, bool);
/// x, whether it is known, excess, complete readings in a row, calls, readings of each output, and whether it is stuck.
type Now<'py> = (Row<'py>, bool, f64, usize, usize, Vec<usize>, bool);

const WHAT: &str = "a loop from readings";

/// Which readings are taken for true.
#[pyclass(frozen, module = "stochens_rs._core", name = "Gate")]
pub(super) struct PyGate(Gate);

#[pymethods]
impl PyGate {
    /// None where `noise` is no bound of a covariance, or the region is unbounded.
    #[staticmethod]
    fn of(py: Python<'_>, region: &Bound<'_, PyRegion>, noise: Matrix<'_>, false_alarm: f64) -> PyResult<Option<Self>> {
        let region = with_noise(&region.get().0, Some(&noise))?;
        Ok(run(py, 0.0, |_| Gate::new(&region, false_alarm))?.map(Self))
    }

    /// How far off readings are, in widths of the gate, behind a known window.
    fn excess(&self, off: Vector<'_>, z: Vector<'_>, seen: Vec<bool>) -> PyResult<f64> {
        Ok(self.0.excess_of(slice("off", &off)?, slice("z", &z)?, &seen)?)
    }
}

fn aimed(aim: &Aimed<'_>) -> PyResult<Aim> {
    let (us, low, high) = (slice("us", &aim.1)?, slice("low", &aim.2)?, slice("high", &aim.3)?);
    Ok(Aim {
        of_bias: try_copy(WHAT, slice("of_bias", &aim.0)?)?,
        limits: [try_copy(WHAT, us)?, try_copy(WHAT, low)?, try_copy(WHAT, high)?],
    })
}

/// `(L, P)` of a bias that is learned: see [`Bias::learned`].
#[pyfunction]
pub(super) fn bias_gain<'py>(
    py: Python<'py>,
    of_inputs: Matrix<'_>,
    drift: Vector<'_>,
    noise: Matrix<'_>,
) -> PyResult<(Made<'py>, Made<'py>)> {
    let drift = slice("drift", &drift)?;
    let found = Bias::learned(view("of_inputs", &of_inputs)?, drift, view("noise", &noise)?)?;
    let p = of_inputs.as_array().nrows();
    Ok((array2(py, found.gain, p, p)?, array2(py, found.spread, p, p)?))
}

/// A window of readings that is kept from call to call.
#[pyclass(frozen, module = "stochens_rs._core", name = "Readings")]
pub(super) struct PyReadings {
    inner: Shared<Readings>,
    cost: f64,
    /// Above which nothing can have been measured.
    most: Vec<f64>,
}

#[pymethods]
impl PyReadings {
    /// Of a model `theta` with the covariance of its noise; `signals`: the mean of the outputs, the range and deviation
    /// of outputs and inputs, and above which no output can have been measured; `bias`: its gain, what is not known of
    /// it, and the noise; `aim`: see [`Self::aim`].
    #[new]
    #[expect(clippy::too_many_arguments, reason = "what a loop from readings is made of")]
    fn new(
        window: &Bound<'_, PyWindow>,
        theta: Matrix<'_>,
        noise: Matrix<'_>,
        signals: (Vector<'_>, Vector<'_>, Vector<'_>),
        gate: Option<&Bound<'_, PyGate>>,
        bias: (Matrix<'_>, Matrix<'_>, Matrix<'_>),
        aim: Aimed<'_>,
        max_missing: usize,
    ) -> PyResult<Self> {
        let (window, theta) = (window.get().0, view("theta", &theta)?);
        let (mean, wide) = (slice("mean", &signals.0)?, slice("wide", &signals.1)?);
        let filter = Filter::new(window, theta, view("noise", &noise)?, mean, wide)?;
        let copied = |name, values: &Matrix<'_>| PyResult::Ok(try_copy(WHAT, slice(name, values)?)?);
        let of = Bias {
            gain: copied("gain", &bias.0)?,
            spread: copied("spread", &bias.1)?,
            noise: copied("noise", &bias.2)?,
        };
        let made = Readings::new(filter, theta, gate.map(|gate| gate.get().0.clone()), of, aimed(&aim)?, max_missing)?;
        let cost = 20.0 * ((window.states() + window.outputs()) as f64).powi(3);
        Ok(Self { inner: Shared::new("loop", made), cost, most: try_copy(WHAT, slice("most", &signals.2)?)? })
    }

    /// Another set point: what a bias adds to its inputs (m, p), these inputs, and their limits.
    fn aim(&self, py: Python<'_>, aim: Aimed<'_>) -> PyResult<()> {
        let aim = aimed(&aim)?;
        self.inner.with(py, 0.0, |inner, _| inner.aim(aim))
    }

    fn step<'py>(
        &self,
        py: Python<'py>,
        y: Vector<'_>,
        acted: Vector<'_>,
        bias: Vector<'_>,
        started: bool,
    ) -> PyResult<Found<'py>> {
        let (y, acted, bias) = (slice("y", &y)?, slice("applied", &acted)?, slice("bias", &bias)?);
        let seen = try_collect(WHAT, y.iter().zip(&self.most).map(|(y, most)| y.abs() <= *most))?;
        let (found, x) = self.inner.with(py, self.cost, |inner, _| {
            let found = inner.step(y, &seen, acted, bias, started)?.clone();
            Ok((found, try_copy(WHAT, inner.window().map_or(&[], |now| &now.x))?))
        })?;
        let follows = match (found.lost, found.runs) {
            (true, _) => "lost",
            (_, false) => "waits",
            (_, true) => "runs",
        };
        let predicted = Some(found.predicted).filter(|predicted| !predicted.is_empty());
        let predicted = predicted.map(|predicted| array1(py, predicted)).transpose()?;
        let whole = !seen.contains(&false);
        Ok((predicted, array1(py, found.bias)?, found.off, found.believed, follows, array1(py, x)?, whole))
    }

    /// Sizes and numbers by their names, for a controller without this core.
    fn tables<'py>(&self, py: Python<'py>) -> PyResult<Tables<'py>> {
        let (sizes, tables) = self.inner.with(py, 0.0, |inner, _| inner.tables())?;
        named(py, sizes, tables)
    }

    /// Go on from the state of a full window.
    fn start(&self, py: Python<'_>, x: Vector<'_>) -> PyResult<()> {
        let x = slice("x", &x)?;
        self.inner.with(py, 0.0, |inner, _| inner.start(x))
    }

    /// None before the first readings.
    #[getter]
    fn now<'py>(&self, py: Python<'py>) -> PyResult<Option<Now<'py>>> {
        let now = self.inner.with(py, 0.0, |inner, _| Ok(inner.window().cloned()))?;
        let handed =
            |now: Contents| Ok((array1(py, now.x)?, now.known, now.excess, now.since, now.calls, now.read, now.stuck));
        now.map(handed).transpose()
    }

    /// The window, those with all that was rejected and with all but the first, and how much doubt there is of the
    /// window.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<([Option<Row<'py>>; 3], Row<'py>)> {
        let ([now, raw, late], doubt) = self.inner.with(py, 0.0, |inner, _| {
            let (windows, doubt) = inner.state()?;
            let mut numbers = [const { None }; 3];
            for (numbers, of) in numbers.iter_mut().zip(windows) {
                *numbers = of.map(Contents::numbers).transpose()?;
            }
            Ok((numbers, doubt))
        })?;
        let handed = |of: Option<Vec<f64>>| of.map(|of| array1(py, of)).transpose();
        Ok(([handed(now)?, handed(raw)?, handed(late)?], array1(py, doubt)?))
    }

    #[pyo3(signature = (windows=None, doubt=None))]
    fn resume(
        &self,
        py: Python<'_>,
        windows: Option<[Option<Vector<'_>>; 3]>,
        doubt: Option<Vector<'_>>,
    ) -> PyResult<()> {
        let mut numbers = [None; 3];
        for (numbers, of) in numbers.iter_mut().zip(windows.iter().flatten()) {
            *numbers = of.as_ref().map(|of| slice("window", of)).transpose()?;
        }
        let doubt = doubt.as_ref().map(|doubt| slice("doubt", doubt)).transpose()?.unwrap_or(&[]);
        self.inner.with(py, 0.0, |inner, _| inner.restore(numbers, doubt))
    }
}
