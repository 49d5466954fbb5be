//! The extension module `stochens_rs._core`.
//!
//! It converts arrays, releases the interpreter, handles signals and maps errors; it computes nothing. Shapes are those
//! of the core: a law's arrays are `(lines, length)`, and the package turns columns or rows of a matrix into lines.

mod arrays;
mod control;
mod convert;
mod covariance;
mod drawn;
mod draws;
mod error;
mod estimate;
mod feedback;
mod fitted;
mod fleet;
mod fuse;
mod horizon;
mod horizon_arguments;
mod horizon_loop;
mod horizon_results;
mod identified;
mod identify;
mod laws;
mod limited;
mod limits;
mod outputs;
mod pieces;
mod pilot;
mod readings;
mod realizations;
mod region;
mod run;
mod set_points;
mod shared;
mod simulate;
mod storage;
mod streaming;
mod table;
mod tails;
mod validation;
mod watch;
mod window;

use pyo3::prelude::*;

/// The Rust core of `stochens_rs`: see the package for the documented interface.
// Without the GIL as well: every class is frozen, and what changes inside is behind a lock.
#[pymodule(gil_used = false)]
mod _core {
    #[pymodule_export]
    use super::control::{PyBest, PyFactors, mean_difference, realization_controls};
    #[pymodule_export]
    use super::covariance::{
        final_covariance, fused_covariance, line_covariances, mean_square, second_moment, trajectory_covariances,
    };
    #[pymodule_export]
    use super::drawn::{drawn_misses, estimate_draws, next_runs};
    #[pymodule_export]
    use super::draws::{Draws, sample_counts};
    #[pymodule_export]
    use super::estimate::{PyEstimate, mixtures};
    #[pymodule_export]
    use super::feedback::{
        PyFeedback, PyKeeper, feedback_gain, guaranteed_gain, loop_eigenvalues, preview, unmoved, widest_gain,
    };
    #[pymodule_export]
    use super::fitted::{PyFitted, fit};
    #[pymodule_export]
    use super::fleet::{
        fleet_alone, fleet_mean, fleet_misses, fleet_worst, scenario_at_most, scenario_compression,
        scenario_discarding, scenario_judged, scenario_rank, scenario_relaxed, scenario_required,
    };
    #[pymodule_export]
    use super::fuse::{Alse, alse, alse_path, alse_prefixes, closed_form, fuse_path};
    #[pymodule_export]
    use super::horizon::PyHorizon;
    #[pymodule_export]
    use super::horizon_loop::PyLoop;
    #[pymodule_export]
    use super::horizon_results::{Apart, HorizonControl};
    #[pymodule_export]
    use super::identified::{PyIdentified, identify, noise_tests};
    #[pymodule_export]
    use super::identify::{residual_checks, triangle, triangle_update};
    #[pymodule_export]
    use super::laws::{
        covariance_root, diagonal_quantile, f_upper, hull_between, hull_explained, hull_position, hull_radius,
        hull_share, joint_radii, least_squares_level, log_multigamma, normal_quantile, one_noise, row_quantile,
        roy_quantile, scalar_quantile, smallest_quantile, sphere_level, trace_quantile, wishart_quantile,
    };
    #[pymodule_export]
    use super::limited::BoxControl;
    #[pymodule_export]
    use super::limits::{box_batch, box_control};
    #[pymodule_export]
    use super::outputs::{entered_region, output_tube};
    #[pymodule_export]
    use super::pieces::PyPieces;
    #[pymodule_export]
    use super::pilot::{PyPilot, PyReference};
    #[pymodule_export]
    use super::readings::{PyGate, PyReadings, bias_gain};
    #[pymodule_export]
    use super::region::{PyErrors, PyPart, PyRegion, certify, followed_inputs};
    #[pymodule_export]
    use super::set_points::{PySetPoint, PySetPoints};
    #[pymodule_export]
    use super::simulate::{
        drawn_bounds, exceedances, simulate_estimates, simulate_plans, simulate_runs, simulate_systems, track,
        trajectory, zero_order_hold,
    };
    #[pymodule_export]
    use super::storage::{StateLock, storage_decode, storage_encode, storage_load, storage_save};
    #[pymodule_export]
    use super::streaming::{PyDataStream, PyStream, mean_radius};
    #[pymodule_export]
    use super::table::{PyTable, instants};
    #[pymodule_export]
    use super::tails::PyTailBounds;
    #[pymodule_export]
    use super::validation::{
        noise_deviations, validation_mean, validation_rank, validation_runs, validation_systems, validation_weighted,
    };
    #[pymodule_export]
    use super::watch::{PyWatch, test_of_two_logs};
    #[pymodule_export]
    use super::window::PyWindow;
    #[pymodule_export]
    use super::{build, version};
}

/// The version of the core.
#[pyfunction]
fn version() -> &'static str {
    env!("CARGO_PKG_VERSION")
}

/// Whether the core is a release build, and the registers for which its kernels were chosen.
#[pyfunction]
fn build() -> (bool, &'static str) {
    (!cfg!(debug_assertions), crate::simd::dispatch::registers())
}
