//! Names of the variants of enums that users print.

/// `as_str` and `Display` of an enum: the name of each variant.
macro_rules! named {
    ($type:ty { $($variant:ident => $name:literal),+ $(,)? }) => {
        impl $type {
            /// Its name, as in the package.
            #[must_use]
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$variant => $name),+ }
            }
        }

        impl std::fmt::Display for $type {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.pad(self.as_str())
            }
        }
    };
}
pub(crate) use named;

#[cfg(test)]
mod tests {
    use crate::feedback::Verdict;
    use crate::limits::Status;

    #[test]
    fn a_variant_prints_as_its_name_and_fills_columns() {
        assert_eq!(Status::Inaccurate.as_str(), "optimal_inaccurate");
        assert_eq!(format!("{}|{:>14}", Status::Limit, Verdict::NotProvable), "user_limit|  not provable");
    }
}
