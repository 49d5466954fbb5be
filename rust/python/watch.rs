//! The alarm of a loop in use, what changed, and tests of new logs.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{Tables, array1, array2, named, slice, view};
use super::fitted::PyFitted;
use super::region::PyRegion;
use super::run::{UNTIL_STOPPED, run};
use super::shared::Shared;
use super::window::PyWindow;
use crate::memory::{try_copy, try_zeros};
use crate::watch::{Bank, Frame, Laws, Null, Promise, Watch, open_loop};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;
type Array1<'py> = Bound<'py, PyArray1<f64>>;
type Array2<'py> = Bound<'py, PyArray2<f64>>;
/// Estimate, radius, and what the region adds; violations; gains with both radii; white, root and factor.
type Looked<'py> = ([Array2<'py>; 3], Array1<'py>, [Array1<'py>; 3], (Array2<'py>, Array2<'py>, f64));
/// Threshold, pairs after the alarm, alarms, and of the first one: call, part, direction, column, whether it fell.
type Now = (f64, f64, f64, Option<(f64, usize, usize, usize, bool)>);

const WHAT: &str = "a watch";

/// An alarm whose false alarms are bounded.
#[pyclass(frozen, module = "stochens_rs._core", name = "Watch")]
pub(super) struct PyWatch(Shared<Watch>);

#[pymethods]
impl PyWatch {
    /// `law`: of the noise, and whether the plant may move; `promise`: steps between false alarms if at least 1, else
    /// the probability of one; `gains`: columns of inputs.
    #[new]
    fn new(
        region: &Bound<'_, PyRegion>,
        noise: Matrix<'_>,
        window: &Bound<'_, PyWindow>,
        law: (&str, bool),
        promise: f64,
        pairs: usize,
    ) -> PyResult<Self> {
        let (window, frame) = (window.get().0, Frame::new(&region.get().0, view("noise", &noise)?, pairs)?);
        let gains = window.count() * window.outputs()..window.length() - usize::from(window.intercept());
        let bank = Bank::new(&frame, gains, window.intercept())?;
        let kind = match law.0 {
            "variance" => Laws::Variance,
            "gaussian" => Laws::Gaussian,
            "symmetric" => Laws::Symmetric,
            _ => Laws::Bounded,
        };
        let null = if law.1 { Null::Moving } else { Null::Constant };
        let promise = if promise >= 1.0 { Promise::Every(promise) } else { Promise::Ever(promise) };
        Ok(Self(Shared::new("watch", Watch::new(frame, bank, (kind, null), promise, window)?)))
    }

    /// Status, evidence, and the number of alarms.
    fn step(&self, py: Python<'_>, y: Vector<'_>, acted: Vector<'_>) -> PyResult<(&'static str, f64, u64)> {
        let (y, acted) = (slice("y", &y)?, slice("u", &acted)?);
        self.0.with(py, 0.0, |watch, _| {
            watch.step(y, acted)?;
            Ok((watch.status(), watch.counts().evidence, watch.counts().alarms as u64))
        })
    }

    /// Takes rows (z, y) as pairs after an alarm.
    fn take(&self, py: Python<'_>, rows: Matrix<'_>) -> PyResult<()> {
        let (width, rows) = (rows.as_array().ncols(), slice("rows", &rows)?);
        self.0.with(py, UNTIL_STOPPED, |watch, _| {
            let (frame, fresh) = watch.after();
            let (n, d) = frame.sizes;
            let [mut e, mut wz] = [try_zeros(WHAT, n)?, try_zeros(WHAT, frame.white.len() / d)?];
            let mut lengths = try_zeros(WHAT, frame.norms.len())?;
            for row in rows.chunks_exact(width).filter(|row| row.len() == frame.outputs + d) {
                if frame.residual(&row[..d], &row[d..], &mut e, &mut wz, &mut lengths) {
                    fresh.add(frame, &row[..d], &e);
                }
            }
            Ok(())
        })
    }

    #[getter]
    fn now(&self, py: Python<'_>) -> PyResult<Now> {
        self.0.with(py, 0.0, |watch, _| {
            let (counts, size) = (watch.counts(), watch.after().1.size());
            let [call, place] = counts.first;
            let (part, direction, column, fell) = watch.bet(place as usize);
            let first = (counts.alarmed > 0.0).then_some((call, part, direction, column, fell));
            Ok((watch.threshold(), size, counts.alarms, first))
        })
    }

    /// Between which calls the change of the alarm began, with `level` left out.
    fn onset(&self, py: Python<'_>, level: f64) -> PyResult<Option<[f64; 2]>> {
        self.0.with(py, UNTIL_STOPPED, |watch, _| watch.onset(level))
    }

    /// The root mean squares of the inputs in the calls before the alarm.
    fn acting<'py>(&self, py: Python<'py>) -> PyResult<Array1<'py>> {
        array1(py, self.0.with(py, 0.0, |watch, _| watch.acting())?)
    }

    /// Direction, column, and the least change that would be seen within so many steps.
    fn sights(&self, py: Python<'_>, steps: f64) -> PyResult<Vec<(usize, usize, f64)>> {
        self.0.with(py, 0.0, |watch, _| watch.sights(steps))
    }

    /// The readings that are watched.
    #[getter]
    fn rows(&self, py: Python<'_>) -> PyResult<Vec<usize>> {
        self.0.with(py, 0.0, |watch, _| try_copy(WHAT, &watch.after().0.rows))
    }

    /// Sizes and numbers by their names, for a controller without this core.
    fn tables<'py>(&self, py: Python<'py>) -> PyResult<Tables<'py>> {
        let (sizes, tables) = self.0.with(py, 0.0, |watch, _| watch.tables())?;
        named(py, sizes, tables)
    }

    fn clear(&self, py: Python<'_>) -> PyResult<()> {
        self.0.with(py, 0.0, |watch, _| {
            watch.clear();
            Ok(())
        })
    }

    fn look<'py>(&self, py: Python<'py>, alpha: f64, groups: Vec<Vec<usize>>) -> PyResult<Looked<'py>> {
        let (n, d, look) = self.0.with(py, UNTIL_STOPPED, |watch, _| {
            let (frame, fresh) = watch.after();
            Ok((frame.outputs, frame.sizes.1, fresh.look(frame, alpha, &groups)?))
        })?;
        let [a, b, c] = look.entries;
        let [gain, new, old] = look.gains;
        let (white, root, factor) = look.allowed;
        let (rows, of) = (white.len() / d, |values| array2(py, values, n, d));
        Ok((
            [of(a)?, of(b)?, of(c)?],
            array1(py, look.violations)?,
            [array1(py, gain)?, array1(py, new)?, array1(py, old)?],
            (array2(py, white, rows, d)?, array2(py, root, rows, d)?, factor),
        ))
    }

    fn state<'py>(&self, py: Python<'py>) -> PyResult<Array1<'py>> {
        array1(py, self.0.with(py, 0.0, |watch, _| watch.numbers())?)
    }

    fn resume(&self, py: Python<'_>, numbers: Vector<'_>) -> PyResult<()> {
        let numbers = slice("numbers", &numbers)?;
        self.0.with(py, 0.0, |watch, _| watch.resume(numbers))
    }
}

/// The exact test of two logs in open loop: statistic and its limit.
#[pyfunction]
pub(super) fn test_of_two_logs(
    py: Python<'_>,
    one: &Bound<'_, PyFitted>,
    other: &Bound<'_, PyFitted>,
    level: f64,
    threads: usize,
) -> PyResult<(f64, f64)> {
    let (one, other) = (&one.get().0, &other.get().0);
    let found = run(py, UNTIL_STOPPED, |stop| open_loop(one, other, level, threads, stop))?;
    Ok((found.statistic, found.limit))
}
