//! What can be said of all members of a region under one gain.

use crate::error::Result;
use crate::named::named;
use crate::parallel::Stop;

use super::data::{Closed, Matrix, Uncertain};
use super::member::unstable;
use super::norm::{balanced, bound, peak, proof};
use super::spectrum::radius;

/// The verdict; only the first one is a promise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
#[must_use = "a gain is proved only where this says so"]
pub enum Verdict {
    /// Every member is stable: the proof has been verified.
    Certified,
    /// A member is unstable: it is in hand.
    Refuted,
    /// The recursion of the proof broke down, and no unstable member was found.
    NotProvable,
    /// The data do not determine the loop, or the region has no bound.
    Undetermined,
    /// Rounding decides.
    Undecided,
}

named!(Verdict {
    Certified => "certified",
    Refuted => "refuted",
    NotProvable => "not provable",
    Undetermined => "undetermined",
    Undecided => "undecided",
});

/// The verdict, with its proof or counterexample.
#[derive(Debug, Clone)]
#[non_exhaustive]
#[must_use = "a gain is proved only where this says so"]
pub struct Certificate {
    /// The verdict.
    pub status: Verdict,
    /// A proved upper bound of `rho g`, infinite without a proof; less than 1 where `status` is certified, at most 1.
    pub norm: f64,
    /// A lower bound of `rho g`, by frequencies; not proved.
    pub least: f64,
    /// The spectral radius of the loop around the centre.
    pub radius: f64,
    /// R (n, n) with `Q = R R'`, in the units of the data, where `status` is certified.
    pub proof: Option<Vec<f64>>,
    /// The multiplier of each part.
    pub multipliers: Vec<f64>,
    /// `[A B c]` (n, d) of an unstable member, where `status` is refuted.
    pub member: Option<Vec<f64>>,
}

/// The verdict about a gain, the root of `Q` in the units of `data`, and the loop with its multipliers.
pub(super) fn judged(data: &Uncertain, closed: Closed, stop: &Stop) -> Result<(Certificate, Option<Matrix>, Closed)> {
    let own = radius(&closed.a0)?;
    let (mut closed, mut found) = (
        closed,
        Certificate {
            status: Verdict::Undetermined,
            norm: f64::INFINITY,
            least: f64::INFINITY,
            radius: own,
            proof: None,
            multipliers: Vec::new(),
            member: None,
        },
    );
    if !own.is_finite() {
        return Ok((found, None, closed));
    }
    if !data.determines(&closed.k) {
        return Ok((found, None, closed));
    }
    let mut top = None;
    if own < 1.0 {
        let (better, largest) = balanced(data, closed, stop)?;
        closed = better;
        found.least = largest.g;
        let (mut broken, mut q) = (false, None);
        if largest.g < 1.0 + 1e-6 {
            for slack in [1.2, 1.02, 1.002, 1.0002, 1.00001] {
                stop.check()?;
                let one = proof(data, &closed, 1.0, 1.0, slack);
                (q, broken) = one;
                if q.is_some() {
                    break;
                }
            }
        } else {
            broken = true;
        }
        found.multipliers = closed.t.clone();
        if q.is_some() {
            found.norm = bound(data, &closed, 1.0, largest.g).min(1.0);
            found.status = Verdict::Certified;
            return Ok((found, q, closed));
        }
        // broken at all sizes that were tried, the last of which is larger by 1e-5
        let beyond = broken && proof(data, &closed, 1.0, 1.0, 1.0).1;
        found.status = if beyond { Verdict::NotProvable } else { Verdict::Undecided };
        found.norm = bound(data, &closed, 1.0, largest.g);
        top = Some(largest);
    } else {
        found.status = Verdict::NotProvable;
        found.multipliers = closed.t.clone();
    }
    found.member = unstable(data, &closed, top.as_ref(), stop)?;
    if found.member.is_some() {
        found.status = Verdict::Refuted;
    }
    Ok((found, None, closed))
}

/// A proved bound of `rho g` for the loop `A0 / t`, `D / t`; infinite without a proof.
pub(super) fn weighted(data: &Uncertain, closed: &Closed, t: f64, stop: &Stop) -> Result<f64> {
    let largest = peak(data, closed, t, stop)?;
    Ok(if largest.g < 1.0 { bound(data, closed, t, largest.g) } else { f64::INFINITY })
}
