use super::*;

/// A small problem with both signs and zeros.
pub(in crate::streaming) fn stream(n: usize, config: Config) -> Stream {
    let entries = |count: usize, turn: f64| -> Vec<f64> {
        (0..count).map(|i| if i % 7 == 5 { 0.0 } else { ((i as f64 + turn) * 2.399).sin() }).collect()
    };
    let m = n.div_ceil(2);
    let geometry = Geometry::new(entries(n * m, 0.5), n, m).unwrap();
    let keys = [1, 2, 3, 4].map(|k| Key([k; 32]));
    let laws = StreamLaws { x0: entries(n, 1.0), xf: entries(n, 2.0), a: entries(n * n, 3.0), keys };
    Stream::new(geometry, laws, config).unwrap()
}

pub(in crate::streaming) fn every_config() -> Vec<Config> {
    let mut all = Vec::new();
    for order in [Order::Random, Order::RoundRobin, Order::Gain] {
        all.extend([false, true].map(|safeguard| Config { safeguard, order }));
    }
    all
}

/// The updated numbers agree with the entries, also long after the last refresh.
#[test]
fn carried_numbers_agree_with_the_entries() {
    for safeguard in [false, true] {
        let config = Config { safeguard, order: Order::Random };
        let mut stream = stream(12, config);
        let [mut line, mut off, ..] = Room::lines(12).unwrap();
        for _ in 0..60 {
            for _ in 0..(stream.refresh_every - 1) {
                stream.step();
            }
            for slot in &stream.slots {
                let (found, fresh, gg) = (slot.run.state, slot.run.sums(), slot.run.gg);
                let er = slot.squared_error([&mut line, &mut off]);
                // a step adds rounding errors of order eps t ||E||^2, and t is of order d / ||E||
                let slack = 1e-12 * (er * gg).sqrt();
                assert!((er - found.er).abs() <= slack, "{er:e} {:e}", found.er);
                assert!((fresh.al - found.al).abs() <= 1e-12 * fresh.ff);
                assert!((fresh.ff - found.ff).abs() <= 1e-12 * fresh.ff);
                slot.check().unwrap();
            }
            let fresh = Products::direct(&stream.slots[2], &stream.start).unwrap();
            assert!(crate::fuse::distance(&fresh.ff, &stream.products.ff) < 1e-12);
            stream.step();
        }
        assert!(stream.drift() < 1e-12 && stream.certificate().unwrap().1 < 0.05);
    }
}

/// For `n = 1` and an entity of a single atom the first realization is exact.
#[test]
fn scalars_are_exact_at_once() {
    for config in every_config() {
        let geometry = Geometry::new(vec![2.0], 1, 1).unwrap();
        let keys = [Key([0; 32]); 4];
        let laws = StreamLaws { x0: vec![-3.0], xf: vec![5.0], a: vec![0.5], keys };
        let mut stream = Stream::new(geometry, laws, config).unwrap();
        for _ in 0..600 {
            assert_eq!(stream.control().unwrap().control, [3.25]);
            assert_eq!(stream.residuals().unwrap(), [0.0; 3]);
            stream.step();
        }
    }
}
