//! An alarm for a loop in use: is the plant still one of those of a region?
//!
//! ```text
//! R = {Theta: (Theta - C) V (Theta - C)' <= S_r},   y = Theta z + w,   e = y - C z,   Cov(w) <= Sbar
//! ```
//!
//! A bet on `l'e` whose expectation is at most 1 for every system of R, whatever the inputs are, is multiplied up from
//! every start; the sum over starts is an e-detector (Shin, Ramdas and Rinaldo 2023), whose false alarms are bounded
//! for all feedbacks. [`Laws`] has the bets, [`Bank`] which of them are made, [`Watch`] their sum and the alarm;
//! [`Fresh`] says what changed from the pairs after an alarm, and [`open_loop`] tests whether two logs are of one
//! plant.

mod accept;
mod alarm;
mod bank;
mod frame;
mod fresh;
mod laws;
mod onset;
mod recent;
mod tables;

pub use accept::{OpenLoop, open_loop};
pub use alarm::{Counts, Promise, Watch};
pub use bank::{Bank, Null};
pub use frame::Frame;
pub use fresh::{Fresh, Look};
pub use laws::Laws;

#[cfg(test)]
mod tests;
