//! The sequential algorithm as two Python objects, which threads may share.

use std::time::{Duration, Instant};

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyAny;

use super::convert::{array1, array2, key, slice};
use super::error::InputError;
use super::realizations::dense;
use super::run::run_unstoppable;
use super::shared::Shared;
use super::storage::{Array, array_of};
use crate::memory::{try_collect, try_copy, try_room};
use crate::storage::{Section, Sections, Values};
use crate::streaming::{Budget, Config, DataStream, Geometry, Order, Rule, Stream, StreamLaws};
use crate::{Key, Result};

type Array1<'py> = Bound<'py, PyArray1<f64>>;
type Array2<'py> = Bound<'py, PyArray2<f64>>;

/// Elementary operations of one evaluation for `n` states.
fn square(n: usize) -> f64 {
    10.0 * (n * n) as f64
}

fn geometry(py: Python<'_>, b: &PyReadonlyArray2<'_, f64>) -> PyResult<Geometry> {
    let (n, m) = b.as_array().dim();
    let values = try_copy("B", slice("B", b)?)?;
    let cost = 10.0 * (n * m * n.min(m)) as f64;
    run_unstoppable(py, cost, move || Geometry::new(values, n, m))
}

fn to_python<'py>(py: Python<'py>, sections: Sections) -> PyResult<Vec<(String, Bound<'py, PyAny>)>> {
    let mut made = try_room("the sections", sections.0.len())?;
    for section in sections.0 {
        made.push((section.name.into_owned(), array_of(py, section.values)?));
    }
    Ok(made)
}

fn from_python(sections: Vec<(String, Array<'_>)>) -> PyResult<Sections> {
    const WHAT: &str = "a state";
    let mut plain = try_room(WHAT, sections.len())?;
    for (name, array) in sections {
        let values = match array {
            Array::Bytes(values) => Values::Bytes(try_collect(WHAT, values.as_array().iter().copied())?.into()),
            Array::Integers(values) => Values::Integers(try_collect(WHAT, values.as_array().iter().copied())?.into()),
            Array::Reals(values) => Values::Reals(try_collect(WHAT, values.as_array().iter().copied())?.into()),
        };
        plain.push(Section { name: name.into(), values });
    }
    Ok(Sections(plain))
}

/// The algorithm on realizations of its own.
#[pyclass(frozen, name = "Stream", module = "stochens_rs._core")]
pub(super) struct PyStream {
    inner: Shared<Stream>,
    n: usize,
}

impl PyStream {
    fn of(inner: Stream) -> Self {
        Self { n: inner.n(), inner: Shared::new("stream", inner) }
    }

    fn read<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&Stream) -> Result<T> + Send) -> PyResult<T> {
        self.inner.with(py, square(self.n), |stream, _| work(stream))
    }
}

#[pymethods]
impl PyStream {
    /// `a` holds the columns of `A` as rows; `keys` are those of x0, xf, A and the choice of slots, 32 bytes each.
    #[new]
    #[expect(clippy::too_many_arguments, reason = "the arguments of one call")]
    fn new(
        py: Python<'_>,
        b: PyReadonlyArray2<'_, f64>,
        x0: PyReadonlyArray1<'_, f64>,
        xf: PyReadonlyArray1<'_, f64>,
        a: PyReadonlyArray2<'_, f64>,
        keys: [Vec<u8>; 4],
        safeguard: bool,
        slots: &str,
    ) -> PyResult<Self> {
        let order = match slots {
            "random" => Order::Random,
            "round-robin" => Order::RoundRobin,
            "gain" => Order::Gain,
            other => return Err(InputError::new_err(format!("`slots` is unknown: '{other}'"))),
        };
        let mut checked = [Key([0; 32]); 4];
        for (to, bytes) in checked.iter_mut().zip(&keys) {
            *to = key(bytes)?;
        }
        let laws = StreamLaws {
            x0: try_copy("x0", slice("x0", &x0)?)?,
            xf: try_copy("xf", slice("xf", &xf)?)?,
            a: try_copy("A", slice("A", &a)?)?,
            keys: checked,
        };
        let geometry = geometry(py, &b)?;
        let n = geometry.size().0;
        let cost = if order == Order::Gain { square(n) * n as f64 } else { 5.0 * square(n) };
        let config = Config { safeguard, order };
        run_unstoppable(py, cost, move || Stream::new(geometry, laws, config)).map(Self::of)
    }

    /// Up to `steps` steps: "converged", "max_steps" or "time_limit".
    fn advance(
        &self,
        py: Python<'_>,
        steps: u64,
        rule: Option<&str>,
        tol: f64,
        seconds: Option<f64>,
    ) -> PyResult<&'static str> {
        let rule = match rule {
            None => None,
            Some("certificate") => Some(Rule::Certificate),
            Some("printed") => Some(Rule::Printed),
            Some(other) => return Err(InputError::new_err(format!("`rule` is unknown: '{other}'"))),
        };
        // a time beyond the range of the clock is no limit
        let deadline =
            seconds.and_then(|s| Duration::try_from_secs_f64(s).ok()).and_then(|time| Instant::now().checked_add(time));
        let limits = Budget { steps, tolerance: rule.map(|rule| (rule, tol)), deadline };
        let cost = 10.0 * (steps as f64) * self.n as f64;
        Ok(self.inner.with(py, cost, |stream, stop| stream.advance(&limits, stop))?.as_str())
    }

    /// The control (m,).
    fn control<'py>(&self, py: Python<'py>) -> PyResult<Array1<'py>> {
        array1(py, self.read(py, Stream::control)?.control)
    }

    /// The estimates of x0 (n,), xf (n,) and of A, its columns as rows.
    fn estimates<'py>(&self, py: Python<'py>) -> PyResult<(Array1<'py>, Array1<'py>, Array2<'py>)> {
        let [x0, xf, a] = self.read(py, |stream| stream.estimates())?;
        Ok((array1(py, x0)?, array1(py, xf)?, array2(py, a, self.n, self.n)?))
    }

    /// Steps taken, and realizations used for x0, xf, A.
    fn counts(&self, py: Python<'_>) -> PyResult<(u64, [u64; 3])> {
        self.inner.with(py, 1.0, |stream, _| Ok((stream.steps(), stream.counts())))
    }

    /// `||F - E*||` for x0, xf, A.
    fn residuals(&self, py: Python<'_>) -> PyResult<[f64; 3]> {
        self.read(py, |stream| stream.residuals())
    }

    /// The bound on `||B (v - v*)||` and its value.
    fn certificate(&self, py: Python<'_>) -> PyResult<(f64, f64)> {
        self.read(py, |stream| stream.certificate())
    }

    /// The largest relative rounding error of `FA F0` that a refresh has corrected.
    fn drift(&self, py: Python<'_>) -> PyResult<f64> {
        self.inner.with(py, 1.0, |stream, _| Ok(stream.drift()))
    }

    /// Recorded steps (k,), and certificate, error, step size (k, 3).
    fn trace<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyArray1<u64>>, Array2<'py>)> {
        let trace = self.inner.with(py, 1e4, |stream, _| try_copy("the trace", stream.trace()))?;
        let values = try_collect("the trace", trace.iter().map(|e| [e.certificate, e.error, e.size]))?;
        let steps = try_collect("the trace", trace.iter().map(|e| e.step))?;
        Ok((array1(py, steps)?, array2(py, values.into_flattened(), trace.len(), 3)?))
    }

    /// The state as named arrays.
    fn to_sections<'py>(&self, py: Python<'py>) -> PyResult<Vec<(String, Bound<'py, PyAny>)>> {
        let sections = self.read(py, |stream| stream.to_sections())?;
        to_python(py, sections)
    }

    /// The object that `to_sections` saved.
    #[staticmethod]
    fn from_sections(py: Python<'_>, sections: Vec<(String, Array<'_>)>) -> PyResult<Self> {
        let sections = from_python(sections)?;
        let all = f64::INFINITY;
        run_unstoppable(py, all, move || Stream::from_sections(sections)).map(Self::of)
    }
}

/// The algorithm on realizations that are passed in.
#[pyclass(frozen, name = "DataStream", module = "stochens_rs._core")]
pub(super) struct PyDataStream {
    inner: Shared<DataStream>,
    n: usize,
}

#[pymethods]
impl PyDataStream {
    /// `None` for an entity that is averaged.
    #[new]
    fn new(
        py: Python<'_>,
        b: PyReadonlyArray2<'_, f64>,
        x0: Option<PyReadonlyArray1<'_, f64>>,
        xf: Option<PyReadonlyArray1<'_, f64>>,
        a: Option<PyReadonlyArray2<'_, f64>>,
    ) -> PyResult<Self> {
        let targets = [
            x0.as_ref().map(|x0| Ok::<_, PyErr>(try_copy("x0", slice("x0", x0)?)?)).transpose()?,
            xf.as_ref().map(|xf| Ok::<_, PyErr>(try_copy("xf", slice("xf", xf)?)?)).transpose()?,
            a.as_ref().map(|a| Ok::<_, PyErr>(try_copy("A", slice("A", a)?)?)).transpose()?,
        ];
        let geometry = geometry(py, &b)?;
        let n = geometry.size().0;
        Ok(Self { inner: Shared::new("stream", DataStream::new(geometry, targets)?), n })
    }

    /// Realizations of entity 0, 1, 2, one per row, in order.
    fn update(&self, py: Python<'_>, entity: usize, samples: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let samples = dense(&samples)?;
        if entity > 2 {
            return Err(InputError::new_err(format!("`entity` must be 0, 1 or 2, got {entity}")));
        }
        let cost = 5.0 * samples.values().len() as f64;
        self.inner.with(py, cost, |data, stop| data.update(entity, &samples, stop))
    }

    /// The control (m,), and what its rounding moves the state by at most.
    fn control<'py>(&self, py: Python<'py>) -> PyResult<(Array1<'py>, f64)> {
        let best = self.inner.with(py, square(self.n), |data, _| data.control())?;
        Ok((array1(py, best.control)?, best.state_rounding))
    }

    /// The estimates of x0 (n,), xf (n,), A (n, n).
    fn estimates<'py>(&self, py: Python<'py>) -> PyResult<(Array1<'py>, Array1<'py>, Array2<'py>)> {
        let [x0, xf, a] = self.inner.with(py, square(self.n), |data, _| {
            let [x0, xf, a] = data.estimates();
            Ok([try_copy("x0", x0)?, try_copy("xf", xf)?, try_copy("A", a)?])
        })?;
        Ok((array1(py, x0)?, array1(py, xf)?, array2(py, a, self.n, self.n)?))
    }

    /// Per entity: realizations, `sqrt(sum ||E - mean||^2)`, `max ||E - E_1||`, `||F - target||` (nan without one).
    #[expect(clippy::type_complexity, reason = "one tuple per call, named in the stub")]
    fn statistics(&self, py: Python<'_>) -> PyResult<([u64; 3], [f64; 3], [f64; 3], [f64; 3])> {
        self.inner.with(py, square(self.n), |data, _| {
            Ok((data.counts(), data.deviations(), data.spreads(), data.residuals()))
        })
    }

    /// Per entity: a lower bound on the largest distance of two realizations, and a bound on the rounding error of the
    /// mean.
    fn evidence(&self, py: Python<'_>) -> PyResult<([f64; 3], [f64; 3])> {
        self.inner.with(py, square(self.n), |data, _| Ok((data.apart(), data.rounding())))
    }

    /// The bound on `||B (v - v*)||` for the targets, and the value; None unless all three have a target.
    fn certificate(&self, py: Python<'_>) -> PyResult<Option<(f64, f64)>> {
        self.inner.with(py, square(self.n), |data, _| data.certificate())
    }

    /// `||x(K) - xf||` under `inputs` (K, m) for resampled means.
    fn misses<'py>(
        &self,
        py: Python<'py>,
        inputs: PyReadonlyArray2<'_, f64>,
        exact: [bool; 3],
        size: usize,
        key: &[u8],
    ) -> PyResult<Array1<'py>> {
        let (inputs, key) = (slice("inputs", &inputs)?, self::key(key)?);
        let cost = 32.0 * square(self.n) * size as f64;
        array1(py, self.inner.with(py, cost, |data, stop| data.misses(inputs, exact, &key, size, stop))?)
    }

    /// The state as named arrays.
    fn to_sections<'py>(&self, py: Python<'py>) -> PyResult<Vec<(String, Bound<'py, PyAny>)>> {
        let sections = self.inner.with(py, square(self.n), |data, _| data.to_sections())?;
        to_python(py, sections)
    }

    /// The object that `to_sections` saved.
    #[staticmethod]
    fn from_sections(py: Python<'_>, sections: Vec<(String, Array<'_>)>) -> PyResult<Self> {
        let sections = from_python(sections)?;
        let all = f64::INFINITY;
        let data = run_unstoppable(py, all, move || DataStream::from_sections(sections))?;
        Ok(Self { n: data.n(), inner: Shared::new("stream", data) })
    }
}

/// The radius of a running mean for all numbers of realizations at once.
#[pyfunction]
pub(super) fn mean_radius(count: u64, deviation: f64, diameter: f64, delta: f64, size: Option<u64>) -> f64 {
    crate::streaming::mean_radius(count, deviation, diameter, delta, size)
}
