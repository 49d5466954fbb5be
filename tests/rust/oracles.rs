//! Independent solutions: the closed form against Clarabel, controls against a dense evaluation.

use proptest::prelude::*;
use std::sync::Arc;

use stochens::control::{Entity, Realized, pseudoinverse};
use stochens::fuse::{Dense, Settings, Weights, alse, closed_form, distance, second_opinion, slse};
use stochens::{Key, Law, Scheme, Singletons, Stop, sample};

fn draws(values: Vec<f64>, lines: usize, size: usize, seed: u8) -> Singletons {
    let length = values.len() / lines;
    let law = Arc::new(Law::new(values, lines, length).unwrap());
    sample(&law, size, Scheme::Iid, &Key([seed; 32]), 1, &Stop::new()).unwrap()
}

fn entry() -> impl Strategy<Value = f64> {
    prop_oneof![1 => Just(0.0), 4 => -10.0..10.0f64]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// Lemma 4.4, corrected, for any target and both weight sets.
    #[test]
    fn the_closed_form_is_the_solvers_optimum(
        w in prop::collection::vec(entry(), 1..8),
        shift in prop::collection::vec(-3.0..3.0f64, 8),
        size in 1usize..12,
        seed in any::<u8>(),
        exact in any::<bool>(),
        subsimplex in any::<bool>(),
    ) {
        let target: Vec<f64> = w.iter().zip(&shift).map(|(w, s)| if exact { *w } else { w + s }).collect();
        let set = if subsimplex { Weights::Subsimplex } else { Weights::Simplex };
        let draws = draws(w, 1, size, seed);
        let formula = closed_form(&draws, &target, set, &Stop::new()).unwrap();
        let solved = second_opinion(&draws, &target, &Settings::new(set, 1e-9), &Stop::new()).unwrap();
        let scale = target.iter().map(|t| t * t).sum::<f64>() + draws.law().squared_norm();
        prop_assert!(formula.gap.absolute <= 1e-13 * scale);
        // both gaps bound the distance to the same optimum
        prop_assert!((formula.objective - solved.error * solved.error).abs() <= formula.gap.absolute + solved.gap + 1e-13 * scale);
        prop_assert!(distance(&formula.estimate, &draws.combine(&formula.weights, &Stop::new()).unwrap()) <= 1e-13 * scale.sqrt());
    }

    /// ALSE <= SLSE and ALSE <= uniform, up to the certified gap; the gap bounds the distance to any feasible point.
    #[test]
    fn accumulated_is_never_worse(
        values in prop::collection::vec(entry(), 12),
        size in 1usize..40,
        seed in any::<u8>(),
    ) {
        let draws = draws(values.clone(), 3, size, seed);
        let settings = Settings::new(Weights::Simplex, 1e-9);
        let alse = alse(&draws, &values, &settings, &Stop::new()).unwrap();
        let second = second_opinion(&draws, &values, &settings, &Stop::new()).unwrap();
        let slse = slse(&draws, &values, false, &[size], false, &Stop::new()).unwrap();
        let safe = stochens::fuse::slse(&draws, &values, true, &[size], false, &Stop::new()).unwrap();
        let mean = draws.combine(&vec![1.0 / size as f64; size], &Stop::new()).unwrap();
        let squared = |e: f64| e * e;
        let slack = 1e-12 * draws.law().squared_norm();
        prop_assert_eq!(alse.status, stochens::fuse::WeightStatus::Optimal);
        // two solvers, one optimum: they agree within their gaps
        prop_assert!((squared(alse.error) - squared(second.error)).abs() <= alse.gap + second.gap + slack);
        for other in [slse.errors[0], safe.errors[0], distance(&mean, &values)] {
            prop_assert!(squared(alse.error) <= squared(other) + alse.gap + slack);
        }
        prop_assert!(squared(safe.errors[0]) <= squared(distance(&mean, &values)) + slack);
    }

    /// The O(m) controls of singletons equal those of the same realizations written out.
    #[test]
    fn sparse_controls_equal_dense_ones(
        a in prop::collection::vec(entry(), 9),
        x0 in prop::collection::vec(entry(), 3),
        xf in prop::collection::vec(entry(), 3),
        b in prop::collection::vec(entry(), 6),
        rows in any::<bool>(),
        seed in any::<u8>(),
    ) {
        let size = 30;
        let (dx0, dxf) = (draws(x0, 1, size, seed), draws(xf, 1, size, seed.wrapping_add(1)));
        let da = draws(a, 3, size, seed.wrapping_add(2));
        let written = |d: &Singletons, transpose: bool| -> Vec<f64> {
            (0..size).flat_map(|s| {
                let mut weights = vec![0.0; size];
                weights[s] = 1.0;
                let e = d.combine(&weights, &Stop::new()).unwrap();
                if transpose { (0..9).map(|k| e[(k % 3) * 3 + k / 3]).collect() } else { e }
            }).collect()
        };
        let (wx0, wxf, wa) = (written(&dx0, false), written(&dxf, false), written(&da, !rows));
        let p = pseudoinverse(&b, 3, 2).unwrap();
        let single = |draws, rows| Entity::Singletons { draws, rows };
        let sparse = Realized::new(single(dx0, false), single(dxf, false), single(da, rows), 3).unwrap();
        let dense = Realized::new(
            Entity::Dense(Dense::new(&wx0, size, 3).unwrap()),
            Entity::Dense(Dense::new(&wxf, size, 3).unwrap()),
            Entity::Dense(Dense::new(&wa, size, 9).unwrap()),
            3,
        ).unwrap();
        let (us, ud) = (
            sparse.controls(&p.matrix, 2, 2, &Stop::new()).unwrap(),
            dense.controls(&p.matrix, 2, 1, &Stop::new()).unwrap(),
        );
        let scale = ud.iter().fold(1e-12f64, |m, v| m.max(v.abs()));
        prop_assert!(distance(&us, &ud) <= 1e-12 * scale * (us.len() as f64));
        prop_assert!(distance(&sparse.mean(&Stop::new()).unwrap(), &dense.mean(&Stop::new()).unwrap()) <= 1e-9);
    }
}
