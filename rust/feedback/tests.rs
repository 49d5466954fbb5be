use std::sync::Arc;

use super::*;
use crate::region::Region;
use crate::{MatrixView, Stop};

/// Around `[A B]` with `V = I` and `S = I`.
fn round(centre: &[f64], n: usize, m: usize, rho: f64) -> Region {
    let d = n + m;
    let part = crate::region::tests::round(&Vec::from_iter(0..n), &Vec::from_iter(0..d), rho * rho);
    Region::new(MatrixView::of(centre, d), m, vec![part], None, false).unwrap()
}

fn near(found: f64, expected: f64, within: f64) {
    assert!((found - expected).abs() <= within * expected.abs(), "{found} is not {expected}");
}

/// One state: `Q` is a root of `e2 q^2 - (1 - a0^2 + e2 rho^2) q + rho^2 = 0`, `g = sqrt(1 + K^2) / (1 - |a + b K|)`.
#[test]
fn one_state() {
    let region = round(&[1.2, 1.0], 1, 1, 0.3);
    let found = Loop::new(&region, &[[-0.9]], &Stop::new()).unwrap();
    let one = found.certificate();
    assert_eq!(one.status, Verdict::Certified);
    near(one.least, 0.3 * 1.81f64.sqrt() / 0.7, 1e-7); // rho is widened by 1e-8
    assert!(one.norm >= one.least && one.norm <= one.least * 1.002);
    let q = found.invariant(&[0.0], 1.0, 1.0, Some(0.0)).unwrap().unwrap();
    near(q[0] * q[0], 0.101142725470413, 1e-6); // its root
    for (by, status) in [(0.999, Verdict::Certified), (1.001, Verdict::Refuted)] {
        let region = round(&[1.2, 1.0], 1, 1, by * 0.7 / 1.81f64.sqrt());
        assert_eq!(Loop::new(&region, &[[-0.9]], &Stop::new()).unwrap().certificate().status, status);
    }
}

#[test]
fn widest_margins_of_one_state() {
    for (centre, most) in
        [([1.2, 1.0], 0.640184399664), ([0.5, 1.0], 0.894427190999916), ([0.9, 0.1], 0.14142135623731)]
    {
        let found = widest(&round(&centre, 1, 1, 0.01), &Stop::new()).unwrap();
        near(0.01 * found.parameter, most, 1e-3);
        let (margin, k) = (|k: f64| (1.0 - (centre[0] + centre[1] * k).abs()) / k.hypot(1.0), found.gain[0]);
        assert!(margin(k) > 0.9 * most && margin(k) < most * (1.0 + 1e-9), "{k}");
    }
}

/// A recursion that jumps over horizons without a solution and converges all the same.
#[test]
fn traps_are_refused() {
    let found = widest(&round(&[1.5, 0.3], 1, 1, 0.45), &Stop::new()).unwrap();
    near(0.45 * found.parameter, 1.0 / 26f64.sqrt(), 1e-3);
    let found = widest(&round(&[1.5, 0.6, -0.4, 0.9, -1.5, 1.0], 2, 1, 0.4), &Stop::new()).unwrap();
    assert!(found.parameter < 1.0);
    assert!(guaranteed(&round(&[1.5, 0.3], 1, 1, 0.45), &[[1.0]], &[[1.0]], None, &Stop::new()).is_err());
}

/// One state at the set point 1: `rho / .7 |(1, us)| / (1 - rho g)`, as `1.2 + us = 1`.
#[test]
fn rests_of_one_state() {
    let found = Loop::new(&round(&[1.2, 1.0], 1, 1, 0.3), &[[-0.9]], &Stop::new()).unwrap();
    let (rows, radius) = found.rest(&[1.0], &[-0.2]).unwrap();
    let expected = 0.3 / 0.7 * 1.04f64.sqrt() / (1.0 - 0.3 * 1.81f64.sqrt() / 0.7);
    near(rows[0], expected, 1e-5);
    near(rows[1], 0.9 * expected, 1e-5);
    assert!(radius >= expected && rows[0] >= expected);
    assert!(found.rest(&[1.0, 0.0], &[-0.2]).is_err());
}

/// Limits so wide that nothing lacks, and so narrow that noise alone is too much.
#[test]
fn plans_are_accepted_within_limits_only() {
    let found = Arc::new(Loop::new(&round(&[1.2, 1.0], 1, 1, 0.1), &[[-0.9]], &Stop::new()).unwrap());
    for (limit, accepted) in [(10.0, true), (0.5, false)] {
        let sides = ([f64::NEG_INFINITY, -limit], [f64::INFINITY, limit]);
        let keeper = Keeper::new(Arc::clone(&found), ((&sides.0, &sides.1), &[]), &[0.01], 0.05, 50).unwrap().unwrap();
        let judged = keeper.judge(&[1.0], &[-0.4, -0.2], false, &Stop::new()).unwrap();
        let sharp = keeper.judge(&[1.0], &[-0.4, -0.2], true, &Stop::new()).unwrap();
        assert_eq!(judged.short.is_none(), accepted);
        assert!(sharp.model[1] <= judged.model[1] * (1.0 + 1e-5));
        // u(1) = -.2 + K (x - xb), xb = 1.2 - .4
        near(keeper.follow(&[1.0], &[-0.4, -0.2], 1, &[1.0]).unwrap()[0], -0.2 - 0.9 * 0.2, 1e-9);
    }
}

/// The input before as a state behind x, and `u - v` as a row: its largest changes are .48 in the steps 2 and 3, and
/// noise adds `zeta .9 sqrt(1.4 / .91) .1` at least.
#[test]
fn changes_of_inputs_are_kept_within_limits() {
    let one = Loop::new(&round(&[1.2, 1.0], 1, 1, 0.1), &[[-0.9]], &Stop::new()).unwrap();
    let parts = || vec![crate::region::tests::round(&[0], &[0, 2], 0.01)];
    let wider = |a: f64| Region::new(&[[1.2, a, 1.0], [0.0, 0.0, 1.0]], 1, parts(), None, false).unwrap();
    assert!(one.behind(&wider(0.0), &[[-0.9, 0.1]], &Stop::new()).is_err());
    assert!(one.behind(&wider(0.1), &[[-0.9, 0.0]], &Stop::new()).is_err());
    assert!(one.behind(&round(&[1.2, 1.0], 1, 1, 0.1), &[[-0.8]], &Stop::new()).is_err());
    let all = Arc::new(one.behind(&wider(0.0), &[[-0.9, 0.0]], &Stop::new()).unwrap());
    near(all.certificate().norm, one.certificate().norm, 1e-9);
    let far = f64::INFINITY;
    for (limit, accepted) in [(2.0, true), (0.9, false)] {
        let sides = ([-far, -far, -far, -limit], [far, far, far, limit]);
        let below = ((&sides.0[..], &sides.1[..]), &[0.0, -1.0, 1.0][..]);
        let keeper = Keeper::new(Arc::clone(&all), below, &[0.01, 0.0, 0.0, 0.0], 0.05, 50).unwrap().unwrap();
        let judged = keeper.judge(&[1.0, 0.0], &[-0.4, -0.2], true, &Stop::new()).unwrap();
        assert_eq!(judged.short.map(|short| (short.row, short.step)), if accepted { None } else { Some((3, 3)) });
        // zeta of 2 sides and 1275 pairs
        let least = 4.1121 * 0.09 * (1.4f64 / 0.91).sqrt();
        assert!((1.0..1.2).contains(&(keeper.noise()[3] / least)), "{} of {least}", keeper.noise()[3]);
        assert!(judged.model[3] > 0.0);
    }
    assert!(Keeper::new(all, ((&[-1.0; 3], &[1.0; 3]), &[1.0]), &[0.01; 4], 0.05, 50).is_err());
}

/// The oracles of one state: `|a0| + rho sqrt(1 + K^2) + gamma = 1` is exact for a term of x in its own row.
#[test]
fn allowances_of_one_state() {
    for rho in [0.3, 0.1] {
        let found = Loop::new(&round(&[1.2, 1.0], 1, 1, rho), &[[-0.9]], &Stop::new()).unwrap();
        let exact = 0.7 - rho * 1.81f64.sqrt();
        for (sign, column) in [(1.0, 0), (-1.0, 0), (1.0, 1)] {
            let mut h = [0.0, 0.0];
            h[column] = sign;
            // of u = K x: |K| times as much
            let exact = exact / if column == 1 { 0.9 } else { 1.0 };
            let one = found.allows(&[sign], &h, &Stop::new()).unwrap();
            assert!(one.certified <= exact && one.certified > 0.995 * exact, "{} of {exact}", one.certified);
            near(one.nominal, 0.7 / if column == 1 { 0.9 } else { 1.0 }, 1e-6);
        }
        assert!(found.allows(&[1.0], &[1.0], &Stop::new()).is_err());
    }
}

/// The value of `f`, increasing, is 1 here.
fn root(mut low: f64, mut high: f64, f: impl Fn(f64) -> f64) -> f64 {
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        *(if f(middle) < 1.0 { &mut low } else { &mut high }) = middle;
    }
    low
}

/// Gain and phase of one state, where `|a + b kappa K| + rho |(1, kappa K)| < 1` is exact, also with an uncertain
/// input.
#[test]
fn margins_of_one_state() {
    for (a, rho) in [(1.2, 0.3), (0.6, 0.3), (1.2, 0.0), (1.2, 0.05)] {
        let found = Loop::new(&round(&[a, 1.0], 1, 1, rho), &[[-0.9]], &Stop::new()).unwrap();
        let one = found.margins(None, &Stop::new()).unwrap();
        let size = |kappa: f64, phase: f64| {
            let (re, im) = (kappa * phase.cos(), kappa * phase.sin());
            (a - 0.9 * re).hypot(0.9 * im) + rho * (0.81 * kappa * kappa).mul_add(1.0, 1.0).sqrt()
        };
        let (least, most) = (1.0 - root(0.0, 1.0, |v| size(1.0 - v, 0.0)), root(1.0, 9.0, |v| size(v, 0.0)));
        let phase = root(0.0, std::f64::consts::PI, |v| size(1.0, v));
        let [low, high] = one.gains[0];
        assert!(low.certified >= least && low.certified <= least + 5e-3, "{} of {least}", low.certified);
        assert!(high.certified <= most && high.certified >= most - 5e-3, "{} of {most}", high.certified);
        let turn = one.phases[0].certified;
        assert!(turn <= phase && turn >= phase - 5e-3, "{turn} of {phase}, {a}, {rho}");
        // symmetric disk: the worst of both ends of the gain and of the phase
        let alpha = root(0.0, 1.99, |v| {
            let worst = |turn: f64| {
                let (re, im) = (turn.cos() * v / 2.0, turn.sin() * v / 2.0);
                let scale = ((1.0 - re).powi(2) + im * im).recip();
                let (re, im) = ((1.0 - re * re - im * im) * scale, 2.0 * im * scale);
                (a - 0.9 * re).hypot(0.9 * im) + rho * (1.0 + 0.81 * (re * re + im * im)).sqrt()
            };
            (0..=200).map(|k| worst(std::f64::consts::PI * f64::from(k) / 200.0)).fold(0.0, f64::max)
        });
        let disk = one.disks[0].certified;
        assert!(disk <= alpha * (1.0 + 1e-9) && disk >= 0.98 * alpha, "{disk} of {alpha}");
        assert!((one.disk.certified - disk).abs() < 1e-9);
        for margin in [one.phases[0], one.disks[0], one.disk, one.delay, one.varying, one.readings] {
            assert!(margin.certified <= margin.nominal * (1.0 + 1e-3), "{margin:?}");
        }
        for margin in [one.gains[0][0], one.bits, one.share] {
            assert!(margin.certified >= margin.nominal * (1.0 - 1e-3), "{margin:?}");
        }
    }
}

/// With an uncertain B a channel at the input must go through the region as well:
/// `.3 + .9 x + .3 sqrt(1 + .81 (1 + x)^2) = 1`.
#[test]
fn input_channels_carry_the_uncertain_input() {
    use super::blocks::{Blocks, Channel};
    use super::data::{Uncertain, matrix};
    let data = Uncertain::new(&round(&[0.6, 1.0], 1, 1, 0.3)).unwrap();
    let (own, one) = (data.unit[0], |v: f64| matrix(&[v], 1, 1));
    let k = one(-0.9 * own);
    let channel = Channel::at_inputs(one(1.0), k.clone());
    let allowed = |channel: Channel| {
        let of = Blocks::new(&data, &k, None, &[1.0], &[channel]);
        scalings::largest(&of, &[1.0], 9.0, &Stop::new()).unwrap().0.gamma
    };
    let found = allowed(channel);
    assert!(found <= 0.271259975206 && found > 0.27, "{found}");
    // the trap: B of the centre alone
    let found = allowed(Channel::at_states(one(1.0 / own), k.clone(), 1));
    assert!(found > 0.3285 && found <= 0.329323642875, "{found}");
}

/// The proof is exact about its numbers: what is larger by 1e-4, a multiplier that is inverted, or no number, is
/// refused.
#[test]
fn proofs_with_a_channel_are_sharp() {
    use super::blocks::{Blocks, Channel};
    use super::data::{Uncertain, matrix};
    let data = Uncertain::new(&round(&[1.2, 1.0], 1, 1, 0.3)).unwrap();
    let (own, one) = (data.unit[0], |v: f64| matrix(&[v], 1, 1));
    let channel = Channel::at_states(one(1.0 / own), one(own), 1);
    let of = Blocks::new(&data, &one(-0.9 * own), None, &[1.0], &[channel]);
    let most = 0.296391278588;
    let t = |gamma: f64| 0.3 / (gamma * 1.81f64.sqrt());
    let gamma = 0.99 * most;
    let root = of.proof(&[gamma], &[t(gamma)], (None, 1.0), 1.0005).unwrap();
    let holds = |root: f64, gamma: f64, t: f64, lambda: f64| of.verified(&one(root), &[gamma], &[t], (None, lambda));
    let r = root[(0, 0)];
    assert!(holds(r, gamma, t(gamma), 1.0));
    assert!(!holds(r, 1.001 * most, t(most), 1.0) && !holds(r, gamma, 1.0 / t(gamma), 1.0));
    for bad in [f64::NAN, f64::INFINITY, -1.0, 0.0] {
        assert!(!holds(r, gamma, bad, 1.0) && !holds(r, gamma, t(gamma), bad));
        assert!(bad == 0.0 || !holds(r, bad, t(gamma), 1.0));
        assert!(bad == -1.0 || !holds(bad, gamma, t(gamma), 1.0));
    }
    assert!(!holds(r, gamma, t(gamma), 1.1));
    for k in -40..=40 {
        let t = t(most) * 10f64.powf(f64::from(k) / 20.0);
        assert!(of.proof(&[1.001 * most], &[t], (None, 1.0), 1.0001).is_none());
    }
    // one Q is the least: .15999888 at gamma = .2
    let root = of.proof(&[0.2], &[1.114941219371], (None, 1.0), 1.00001).unwrap();
    near((own * root[(0, 0)]).powi(2), 0.15999888, 1e-3);
}

/// Errors of the inputs of one state: `.05` moves it by `.083970` at most, `.083967886806` for a constant member.
#[test]
fn errors_of_the_inputs() {
    let found = Loop::new(&round(&[1.2, 1.0], 1, 1, 0.1), &[[-0.9]], &Stop::new()).unwrap();
    let moved = found.errors(&[0.05], &Stop::new()).unwrap();
    assert!(moved[0] >= 0.083967886806 && moved[0] < 0.0842, "{}", moved[0]);
    near(moved[1], 0.9 * moved[0], 1e-6);
    assert_eq!(found.errors(&[0.0], &Stop::new()).unwrap(), [0.0, 0.0]);
    assert!(found.errors(&[f64::NAN], &Stop::new()).is_err());
    let rounded = found.computed(&[1.0, 9.0], &[0.9e-7, 0.0], &[1e-9], &Stop::new()).unwrap();
    near(rounded[0], moved[0] / 0.05 * (0.9e-7 + 1e-9), 1e-3);
    assert!(found.computed(&[1.0, 0.9], &[0.81, 0.0], &[1e-9], &Stop::new()).unwrap()[0].is_infinite());
}

/// Saturation of one unstable state: `x = 1 / (.9 kappa)`, kappa the root of
/// `1.2 - .9 kappa + rho sqrt(1 + .81 kappa^2) = 1`.
#[test]
fn saturated_inputs() {
    for (rho, exact) in [(0.0, 5.0), (0.1, 3.283702811636)] {
        let found = Loop::new(&round(&[1.2, 1.0], 1, 1, rho), &[[-0.9]], &Stop::new()).unwrap();
        let far = found.attracted(&[1.0], &[1.0], &Stop::new()).unwrap();
        assert!(far <= exact && far > 0.9 * exact, "{far} of {exact}");
        near(found.attracted(&[2.0], &[-0.5], &Stop::new()).unwrap(), 4.0 * far, 1e-6);
    }
}

/// One step of delay of one state: `rho` up to `.0575747` is proved, `1 / g = .057575317147`.
#[test]
fn one_step_of_delay() {
    for (rho, steps) in [(0.0575, 1.0), (0.0577, 0.0)] {
        let found = Loop::new(&round(&[1.2, 1.0], 1, 1, rho), &[[-0.9]], &Stop::new()).unwrap();
        let delay = found.margins(None, &Stop::new()).unwrap().delay;
        assert_eq!((delay.certified, delay.nominal), (steps, 1.0));
    }
}
