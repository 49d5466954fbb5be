//! Realizations of vectors and matrices, drawn and stored as indices (paper, Lemma 4.1).
//!
//! A [`Law`] is a set of independent *lines* (one for a vector, one per column or row of a matrix). A realization picks
//! one index per line, with probability `p_i = |w_i| / g`, `g = ||w||_1`, and has the single value `g sign(w_i)` there,
//! so that its mean is `w`. [`Singletons`] holds `N` realizations as `N x lines` indices of one, two or four bytes.

mod categorical;
mod counts;
mod iid;
mod law;
mod sequence;
mod singletons;
#[cfg(test)]
mod statistics;
mod systematic;

pub use categorical::AliasTable;
pub use counts::multinomial_counts;
pub use law::Law;
pub use sequence::Sequence;
pub use singletons::{Index, Indices, Singletons};
pub use systematic::systematic_counts;

pub(crate) use counts::{Chance, binomial, chances, deal, line_counts};
pub(crate) use singletons::with_indices;
pub(crate) use systematic::line_systematic;

use crate::error::Result;
use crate::memory::checked_len;
use crate::named::named;
use crate::parallel::Stop;
use crate::stream::Key;
use std::sync::Arc;

/// How the realizations of a sample depend on each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scheme {
    /// Independent and identically distributed.
    Iid,
    /// One random offset per line: every index is drawn `floor(N p)` or `ceil(N p)` times, in random order.
    Systematic,
}

named!(Scheme { Iid => "iid", Systematic => "systematic" });

/// Draws `size` realizations of `law`.
///
/// With [`Scheme::Iid`], realization `i` depends on `(key, i)` only: a longer sample starts with the shorter one.
///
/// # Errors
/// [`crate::Error::Memory`] if the indices do not fit, [`crate::Error::Interrupted`] after a stop.
///
/// # Example
/// ```
/// use stochens::{Key, Law, Scheme, Stop, sample};
/// let law = Law::new(vec![3.0, -1.0, 0.0], 1, 3)?;
/// let draws = sample(&law.into(), 1000, Scheme::Iid, &Key([7; 32]), 2, &Stop::new())?;
/// assert_eq!(draws.counts(&Stop::new())?[2], 0); // a zero component is never drawn
/// # Ok::<(), stochens::Error>(())
/// ```
pub fn sample(
    law: &Arc<Law>,
    size: usize,
    scheme: Scheme,
    key: &Key,
    threads: usize,
    stop: &Stop,
) -> Result<Singletons> {
    let len = checked_len("the indices of a sample", size, law.lines())?;
    let mut indices = Indices::zeros(law.length(), len)?;
    with_indices!(&mut indices, out => match scheme {
        Scheme::Iid => iid::fill(law, key, out, threads, stop)?,
        Scheme::Systematic => systematic::fill(law, key, out, size, stop)?,
    });
    Ok(Singletons::from_parts(Arc::clone(law), Arc::new(indices), size))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line of zeros has index 0 in every realization.
    #[test]
    fn every_index_is_written() {
        let law = Arc::new(Law::new(vec![1.0, 2.0, 0.0, 0.0, -3.0, 1.0], 3, 2).unwrap());
        let size = 400_000;
        for scheme in [Scheme::Iid, Scheme::Systematic] {
            let draws = sample(&law, size, scheme, &Key([9; 32]), 1, &Stop::new()).unwrap();
            let Indices::U8(indices) = &**draws.indices() else { panic!("two entries need one byte") };
            assert!(indices.chunks_exact(3).all(|line| line[0] < 2 && line[1] == 0 && line[2] < 2), "{scheme:?}");
        }
    }
}
