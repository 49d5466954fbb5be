//! Loops in files: what is proved of one is proved again when it is loaded.

use super::certificate::Verdict;
use super::data::Misfit;
use super::loops::Loop;
use crate::error::Result;
use crate::matrix::MatrixView;
use crate::memory::try_push;
use crate::parallel::Stop;
use crate::region::Region;
use crate::storage::{Saved, Sections, damaged};

const FORMAT: u64 = 1;

const VERDICTS: [Verdict; 5] =
    [Verdict::Certified, Verdict::Refuted, Verdict::NotProvable, Verdict::Undetermined, Verdict::Undecided];

/// Region, declared terms, gain and verdict. A file whose loop was certified is refused where that is not proved again;
/// one of data in doubt stays so.
impl Saved for Loop {
    const KIND: &'static str = "core.loop";

    fn put(&self, to: &mut Sections) -> Result<()> {
        let verdict = VERDICTS.iter().position(|one| *one == self.certificate.status).unwrap_or(VERDICTS.len());
        self.data.region.put(to)?;
        to.put_u64("loop", &[FORMAT, self.data.misfits.len() as u64, verdict as u64])?;
        to.put_f64("gain", &self.gain())?;
        for (k, misfit) in self.data.misfits.iter().enumerate() {
            to.put_f64(format!("misfit{k}.direction"), &misfit.direction)?;
            to.put_f64(format!("misfit{k}.of"), &misfit.of)?;
            to.put_f64(format!("misfit{k}.most"), &[misfit.most])?;
        }
        Ok(())
    }

    fn take(from: &mut Sections, stop: &Stop) -> Result<Self> {
        let region = Region::take(from, stop)?;
        let [count, verdict] = from.take_sizes("loop", FORMAT)?;
        let gain = from.take_f64("gain", None)?;
        let gain = MatrixView::new(&gain, region.m, region.n)?;
        let mut misfits = Vec::new();
        for k in 0..count {
            let mut values = |name: &str| from.take_f64(&format!("misfit{k}.{name}"), None);
            let (direction, of) = (values("direction")?, values("of")?);
            let most = from.take_reals(&format!("misfit{k}.most"), Some(1))?[0];
            try_push("a state", &mut misfits, Misfit { direction, of, most })?;
        }
        let made = Self::beside(&region, misfits, gain, stop)?;
        match (VERDICTS.get(verdict), made.certificate().status) {
            (Some(Verdict::Certified), Verdict::Certified) => Ok(made),
            (Some(Verdict::Certified), found) => Err(damaged("a loop that is proved again", format!("{found:?}"))),
            (Some(Verdict::Undetermined), _) => Ok(made.doubted()),
            (Some(_), _) => Ok(made),
            (None, _) => Err(damaged("a loop with a verdict", verdict.to_string())),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Debug;
    use std::path::PathBuf;
    use std::sync::LazyLock;

    use proptest::prelude::*;

    use super::*;
    use crate::Error;
    use crate::feedback::least_squares;
    use crate::identify::{Assumed, Covariance, Data, Design, Estimate, Magnitudes, Noise, Wish, triangle};
    use crate::storage::{self, Fault, Values};

    fn go() -> Stop {
        Stop::new()
    }

    /// A folder that is removed at the end.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("stochens-{name}-{}", std::process::id()));
            std::fs::create_dir_all(&path).unwrap();
            Self(path)
        }

        fn file(&self) -> PathBuf {
            self.0.join("a.state")
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            std::fs::remove_dir_all(&self.0).unwrap();
        }
    }

    /// From pairs of `x+ = [1 .1; 0 .9] x + [0; .1] u + w`, with a known second entry or none.
    fn estimate(known: Option<f64>) -> Estimate {
        let mut rows = Vec::new();
        let mut x = [0.3, -0.2];
        for k in (0..60).map(f64::from) {
            let (u, w) = ((1.7 * k * k).sin(), [0.01 * (2.9 * k).sin(), 0.01 * (0.7 * k * k).cos()]);
            let next = [x[0] + 0.1 * x[1] + w[0], 0.9 * x[1] + 0.1 * u + w[1]];
            rows.extend([x[0], x[1], u, next[0], next[1]]);
            x = next;
        }
        let triangle = triangle(&rows, 5, 1, &go()).unwrap();
        let known = known.map(|v| [f64::NAN, v, 0.0, f64::NAN, f64::NAN, f64::NAN]);
        let known = known.as_ref().map(|known| &known[..]);
        Estimate::new(Data { triangle: &triangle, size: 60, n: 2, m: 1, offset: false, known }, &go()).unwrap()
    }

    fn region(estimate: &Estimate, wish: Wish<'_>) -> Region {
        let covariance = Covariance::Known(&[1e-4, 0.0, 0.0, 1e-4]);
        let assumed = Assumed { design: Design::Adaptive, noise: Noise::SubGaussian, covariance, tail: 0.0 };
        Region::from_data(estimate, assumed, wish, Magnitudes::Expected(&[1.0; 3]), 1, &go()).unwrap()
    }

    fn closed(misfits: Vec<Misfit>) -> Loop {
        let of = region(&estimate(None), Wish::new(0.05));
        let (a, b) = ([[1.0, 0.1], [0.0, 0.9]], [[0.0], [0.1]]);
        let gain = least_squares(&a, &b, &[[1.0, 0.0], [0.0, 1.0]], &[[0.1]], &go()).unwrap();
        Loop::beside(&of, misfits, &gain, &go()).unwrap()
    }

    fn misfits() -> Vec<Misfit> {
        vec![Misfit { direction: vec![0.0, 1.0], of: vec![0.0, 1.0, 0.0], most: 0.01 }]
    }

    fn sections(of: &impl Saved) -> Sections {
        let mut sections = Sections::default();
        of.put(&mut sections).unwrap();
        sections
    }

    fn round_trip<T: Saved + Debug>(of: &T, folder: &Folder) {
        of.save(folder.file(), &go()).unwrap();
        let back = T::load(folder.file(), &go()).unwrap();
        // every double is shown with all of its digits
        assert_eq!(format!("{back:?}"), format!("{of:?}"));
        let generation = of.save(folder.file(), &go()).unwrap();
        assert!(generation > 1);
        let before = folder.0.join("a.state.prev");
        assert_eq!(format!("{:?}", T::load(before, &go()).unwrap()), format!("{of:?}"));
        std::fs::remove_file(folder.file()).unwrap();
        assert!(matches!(T::load(folder.file(), &go()), Err(Error::Os { .. }))); // not silently the one before
        std::fs::remove_file(folder.0.join("a.state.prev")).unwrap();
    }

    #[test]
    fn there_and_back_bit_for_bit() {
        let folder = Folder::new("there-and-back");
        for of in [estimate(None), estimate(Some(0.1))] {
            round_trip(&of, &folder);
            round_trip(&region(&of, Wish { frobenius: true, ..Wish::new(0.05) }), &folder);
            round_trip(&region(&of, Wish { components: true, ..Wish::new(0.05) }), &folder);
        }
        let unbounded = region(&estimate(None).after(2, 0.0, &go()).unwrap(), Wish::new(0.05));
        assert!(unbounded.radius().is_infinite() || unbounded.bound(&[1.0; 3], false).unwrap().is_infinite());
        round_trip(&unbounded, &folder);
        assert_eq!(closed(Vec::new()).certificate().status, Verdict::Certified);
        round_trip(&closed(Vec::new()), &folder);
        round_trip(&closed(misfits()), &folder);
        round_trip(&closed(Vec::new()).doubted(), &folder); // the data are in doubt afterwards too
    }

    fn damaged_anywhere<T: Saved + Debug>(of: &T, name: &str) {
        let folder = Folder::new(name);
        of.save(folder.file(), &go()).unwrap();
        let good = std::fs::read(folder.file()).unwrap();
        let refused = |bytes: &[u8]| {
            std::fs::write(folder.file(), bytes).unwrap();
            assert!(matches!(T::load(folder.file(), &go()), Err(Error::State { .. })));
        };
        for at in 0..good.len() {
            refused(&good[..at]);
            let mut bytes = good.clone();
            bytes[at] ^= 1 << (at % 8);
            refused(&bytes);
        }
    }

    #[test]
    fn damage_at_every_byte_is_refused() {
        damaged_anywhere(&estimate(None), "damaged-estimate");
        damaged_anywhere(&region(&estimate(Some(0.1)), Wish::new(0.05)), "damaged-region");
        damaged_anywhere(&closed(misfits()), "damaged-loop");
    }

    #[test]
    fn another_kind_is_refused() {
        let folder = Folder::new("kinds");
        region(&estimate(None), Wish::new(0.05)).save(folder.file(), &go()).unwrap();
        let kind = |error| matches!(error, Error::State { fault: Fault::Kind { .. }, .. });
        assert!(kind(Loop::load(folder.file(), &go()).unwrap_err()));
        assert!(kind(Estimate::load(folder.file(), &go()).unwrap_err()));
        assert!(kind(estimate(None).save(folder.file(), &go()).unwrap_err())); // and not overwritten
        assert!(Region::load(folder.file(), &go()).is_ok());
    }

    /// The reals of a section.
    fn reals<'a>(of: &'a mut Sections, name: &str) -> &'a mut Vec<f64> {
        match of.0.iter_mut().find(|section| section.name == name).map(|section| &mut section.values) {
            Some(Values::Reals(values)) => values.to_mut(),
            other => panic!("{other:?}"),
        }
    }

    /// What is said of the sections of a sealed file.
    fn said<T: Saved + Debug>(sections: &Sections, folder: &Folder) -> String {
        storage::save(&folder.file(), T::KIND, &sections.0, &go()).unwrap();
        match T::load(folder.file(), &go()) {
            Err(Error::State { fault: Fault::Content(why), .. }) => why,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn what_could_not_be_loaded_is_not_saved() {
        let folder = Folder::new("unsaved");
        let no_covariance = Covariance::Known(&[1e-4, 2e-4, -2e-4, 1e-4]);
        let assumed =
            Assumed { design: Design::Adaptive, noise: Noise::SubGaussian, covariance: no_covariance, tail: 0.0 };
        let units = Magnitudes::Expected(&[1.0; 3]);
        let made = Region::from_data(&estimate(None), assumed, Wish::new(0.05), units, 1, &go()).unwrap();
        assert!(made.save(folder.file(), &go()).unwrap_err().to_string().contains("sets"));
        assert!(!folder.file().exists());
    }

    #[test]
    fn a_certificate_that_is_false_is_refused() {
        let folder = Folder::new("forged");
        let good = sections(&closed(Vec::new()));
        let forged = |change: &dyn Fn(&mut Sections)| {
            let mut sections = good.clone();
            change(&mut sections);
            said::<Loop>(&sections, &folder)
        };
        // a gain that pushes away; a region that is larger, or of another model
        assert!(forged(&|of| reals(of, "gain").iter_mut().for_each(|k| *k = -*k)).contains("Refuted"));
        assert!(forged(&|of| reals(of, "part0.sizes")[1] *= 1e6).contains("proved again"));
        assert!(forged(&|of| reals(of, "centre")[0] = 1.5).contains("proved again"));
        // a region that is none, or whose lengths are not those of its data
        assert!(forged(&|of| reals(of, "part0.white").fill(0.0)).contains("sets"));
        assert!(forged(&|of| reals(of, "part0.shape")[0] = -1.0).contains("sets"));
        assert!(forged(&|of| reals(of, "part0.sizes")[0] = f64::NAN).contains("ratios"));
        assert!(forged(&|of| reals(of, "part0.sizes")[1] = f64::NAN).contains("factor"));
        assert!(forged(&|of| reals(of, "centre")[1] = f64::INFINITY).contains("finite"));
        assert!(forged(&|of| of.0.retain(|section| section.name != "gain")).contains("\"gain\""));
        assert!(forged(&|of| of.put_f64("more", &[]).unwrap()).contains("\"more\""));
    }

    /// An estimate, a region and a loop, without and with known entries and declared terms.
    static GOOD: LazyLock<[[Sections; 3]; 2]> = LazyLock::new(|| {
        [(None, Vec::new()), (Some(0.1), misfits())].map(|(known, misfits)| {
            let of = estimate(known);
            let wish = Wish { components: known.is_some(), frobenius: true, ..Wish::new(0.05) };
            [sections(&of), sections(&region(&of, wish)), sections(&closed(misfits))]
        })
    });

    /// A sealed state with one change: a number, or a length, or a type.
    fn changed(mut of: Sections, which: usize, at: usize, bits: u64, how: u8) -> Sections {
        let count = of.0.len();
        let values = &mut of.0[which % count].values;
        match values {
            Values::Integers(v) if how < 3 && !v.is_empty() => {
                let at = at % v.len();
                v.to_mut()[at] = if how == 0 { bits } else { bits % 5 };
            }
            Values::Reals(v) if how < 3 && !v.is_empty() => {
                let at = at % v.len();
                v.to_mut()[at] = match how {
                    0 => f64::from_bits(bits),
                    1 => v[at] * 10f64.powi((bits % 31) as i32 - 15),
                    _ => [0.0, -1.0, 1e-300, 1e154, 1e308, f64::INFINITY][bits as usize % 6],
                };
            }
            Values::Reals(v) if how == 3 => v.to_mut().truncate(at % 9),
            Values::Reals(v) if how == 4 => v.to_mut().push(f64::from_bits(bits)),
            Values::Integers(v) if how == 3 => v.to_mut().push(bits % 7),
            _ => *values = Values::Bytes(vec![7; at % 9].into()),
        }
        of
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            failure_persistence: None,
            ..ProptestConfig::default()
        })]

        /// A sealed file with anything changed: refused, or what was loaded works.
        #[test]
        fn any_damage_of_a_record_is_survived(which: usize, at: usize, bits: u64, how in 0u8..6, twice: bool, known: bool) {
            let [of, region, closed] = &GOOD[usize::from(known)];
            let change = |mut of: Sections| {
                if twice {
                    of = changed(of, at, which, bits.rotate_left(17), (bits % 6) as u8);
                }
                changed(of, which, at, bits, how)
            };
            if let Ok(back) = Estimate::take(&mut change(of.clone()), &go()) {
                let assumed = Assumed { design: Design::Adaptive, noise: Noise::Gaussian, covariance: Covariance::Full, tail: 0.0 };
                let _ = back.after(9, 2.0, &go());
                let _ = Region::from_data(&back, assumed, Wish::new(0.05), Magnitudes::Expected(&[1.0; 3]), 1, &go());
            }
            if let Ok(back) = Region::take(&mut change(region.clone()), &go()) {
                prop_assert!(back.bound(&[1.0; 3], false).unwrap_or(0.0) >= 0.0);
                let _ = (back.contains(&[[1.0; 3]; 2]), back.entry_bounds(), back.spread(0, 2));
            }
            if let Ok(back) = Loop::take(&mut change(closed.clone()), &go()) {
                let certified = back.certificate().status == Verdict::Certified;
                prop_assert_eq!(certified, back.certificate().proof.is_some());
            }
        }
    }
}
