//! Promises to every caller: draws do not depend on threads or size, stops are honoured, bad input is refused.

use std::sync::Arc;

use stochens::region::{Aim, Bias, Readings};
use stochens::sample::{Indices, systematic_counts};
use stochens::simulate::{noise_deviations, zero_order_hold};
use stochens::window::{Filter, Kind, Window};
use stochens::{CHUNK, Error, Key, Law, MatrixView, Scheme, Singletons, Stop, sample};

fn matrix_law() -> Arc<Law> {
    let values = (0..5 * 7).map(|k| if k % 7 == 3 || k / 7 == 2 { 0.0 } else { f64::from(k) - 11.0 }).collect();
    Arc::new(Law::new(values, 5, 7).unwrap())
}

fn bytes(draws: &Singletons) -> Vec<u8> {
    match &**draws.indices() {
        Indices::U8(v) => v[..draws.size() * draws.law().lines()].to_vec(),
        _ => panic!("lines of 7 entries need one byte"),
    }
}

#[test]
fn threads_and_size_do_not_change_draws() {
    let law = matrix_law();
    let key = Key([3; 32]);
    let draw = |size, threads| sample(&law, size, Scheme::Iid, &key, threads, &Stop::new()).unwrap();
    let whole = draw(2 * CHUNK + 3, 1);
    for threads in [2, 3, 8] {
        assert_eq!(bytes(&draw(2 * CHUNK + 3, threads)), bytes(&whole));
    }
    for size in [1, 7, 8, 9, 1023, 1025, CHUNK - 1, CHUNK, CHUNK + 1] {
        assert_eq!(bytes(&draw(size, 2)), bytes(&whole.prefix(size)));
    }
}

#[test]
fn systematic_realizations_have_the_systematic_counts() {
    let law = matrix_law();
    let key = Key([4; 32]);
    let draws = sample(&law, 1000, Scheme::Systematic, &key, 1, &Stop::new()).unwrap();
    let mut counts = draws.counts(&Stop::new()).unwrap();
    counts[2 * 7] = 0; // line 2 is all zero: its index is 0 and means nothing
    assert_eq!(counts, systematic_counts(&law, 1000, &key).unwrap());
}

#[test]
fn a_stop_ends_a_sample() {
    let stop = Stop::new();
    stop.request();
    let result = sample(&matrix_law(), 10, Scheme::Iid, &Key([0; 32]), 1, &stop);
    assert_eq!(result.err(), Some(Error::Interrupted));
}

#[test]
fn bad_laws_and_indices_are_refused() {
    assert!(matches!(Law::new(vec![1.0], 1, 2), Err(Error::Shape { .. })));
    assert!(matches!(Law::new(vec![], 0, 0), Err(Error::Shape { .. })));
    assert!(matches!(Law::new(vec![1.0, f64::NAN], 1, 2), Err(Error::NonFinite { index: 1, .. })));
    assert!(matches!(Law::new(vec![1e308; 3], 1, 3), Err(Error::NonFinite { what: "1-norm", .. })));
    let gappy = Arc::new(Law::new(vec![1.0, 0.0], 1, 2).unwrap());
    assert!(matches!(Singletons::new(gappy, Indices::U8(vec![1]), 1), Err(Error::Value { .. })));
    let law = Arc::new(Law::new(vec![1.0, 2.0], 1, 2).unwrap());
    assert!(matches!(Singletons::new(Arc::clone(&law), Indices::U8(vec![2]), 1), Err(Error::Value { .. })));
    assert!(matches!(Singletons::new(law, Indices::U8(vec![0, 1]), 3), Err(Error::Shape { .. })));
}

#[test]
fn a_sample_that_cannot_fit_is_refused_not_aborted() {
    let law = Arc::new(Law::new(vec![1.0; 1 << 17], 1, 1 << 17).unwrap());
    let result = sample(&law, usize::MAX / 8, Scheme::Iid, &Key([0; 32]), 1, &Stop::new());
    assert!(matches!(result, Err(Error::Memory { .. })));
}

/// They have as many entries as the right ones, and were taken for them.
#[test]
fn transposed_matrices_are_refused_with_their_sizes() {
    let window = Window::new(2, 1, Kind::Lags(1), 0, false, 0).unwrap();
    let (theta, noise, row) =
        ([[0.9, 0.1, 0.5], [0.0, 0.8, 0.1]], [[0.01, 0.0], [0.0, 0.01]], [[0.01, 0.0, 0.0, 0.01]]);
    let turned = [[0.9, 0.0], [0.1, 0.8], [0.5, 0.1]];
    let filter = || Filter::new(window, &theta, &noise, &[0.0; 2], &[1.0; 3]).unwrap();
    let bias = || Bias::learned(&[[0.5], [0.1]], &[0.1], &noise).unwrap();
    let readings = |theta: MatrixView<'_>| {
        let aim = Aim { of_bias: vec![0.0; 2], limits: [vec![0.0], vec![-1.0], vec![1.0]] };
        Readings::new(filter(), theta, None, bias(), aim, 3)
    };
    assert!(window.linear(&theta).is_ok() && readings((&theta).into()).is_ok());
    let of_theta = "`theta` must have 2 x 3 entries, got 3 x 2";
    let refused = [
        (window.linear(&turned).err(), of_theta),
        (window.rest(&turned, &[0.0; 2], &[0.0]).err(), of_theta),
        (Filter::new(window, &turned, &noise, &[0.0; 2], &[1.0; 3]).err(), of_theta),
        (readings((&turned).into()).err(), of_theta),
        (Filter::new(window, &theta, &row, &[0.0; 2], &[1.0; 3]).err(), "`noise` must have 2 x 2 entries, got 1 x 4"),
        (Bias::learned(&[[0.5, 0.1]], &[0.1], &noise).err(), "`of_inputs` must have 2 x 1 entries, got 1 x 2"),
        (zero_order_hold(&noise, &[[1.0, 0.0]], 0.1).err(), "`A` must have 1 x 1 entries, got 2 x 2"),
        (zero_order_hold(&row, &[[1.0], [0.0]], 0.1).err(), "`A` must have 2 x 2 entries, got 1 x 4"),
        (noise_deviations(&noise, &row, 3).err(), "`covariance` must have 2 x 2 entries, got 1 x 4"),
    ];
    for (found, expected) in refused {
        assert_eq!(found.unwrap().to_string(), expected);
    }
}
