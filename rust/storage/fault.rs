//! What can be wrong with a state file.

use super::format::{MAX_BYTES, MAX_SECTIONS, SMALLEST, VERSION};

/// Why a file is not accepted as a state file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of each variant says what its fields are")]
pub enum Fault {
    #[error("is not a state file: it begins with other bytes")]
    Foreign,
    #[error("is damaged: it begins with zeros, as a file does whose data never reached the disk")]
    Blank,
    #[error("is damaged: it has {found} bytes, and a state file has at least {SMALLEST}")]
    Truncated { found: usize },
    #[error("is damaged: it says that it has {declared} bytes, and has {found}")]
    Length { declared: u64, found: usize },
    #[error("is damaged: its contents do not give the checksum at its end")]
    Checksum,
    #[error("has format version {found}, and this release reads version {VERSION}")]
    Version { found: u32 },
    #[error("holds a state of kind '{found}', and '{expected}' was asked for")]
    Kind { found: String, expected: String },
    #[error("has {found} sections: at most {MAX_SECTIONS} are allowed, and all must be in the table")]
    Sections { found: u32 },
    #[error("has a malformed name {bytes:?}")]
    Name { bytes: [u8; 8] },
    #[error("has two sections named '{tag}'")]
    Duplicate { tag: String },
    #[error("has a section '{tag}' of unknown element type {code}")]
    Element { tag: String, code: u32 },
    #[error("has nonzero bytes in a field or a padding that must be zero (section '{tag}')")]
    Padding { tag: String },
    #[error("has sections that do not fill it exactly (seen at section '{tag}')")]
    Sizes { tag: String },
    #[error("has no section '{tag}' of {expected}")]
    Missing { tag: String, expected: &'static str },
    #[error("has contents that cannot be: {0}")]
    Content(String),
    #[error("is {what}, not a regular file")]
    NotRegular { what: &'static str },
    #[error("has {found} bytes, more than the {MAX_BYTES} that are read")]
    TooLarge { found: u64 },
}

impl Fault {
    /// Whether the file was once good, or may have been, so that the previous generation may stand in for it.
    pub(super) fn is_damage(&self) -> bool {
        match self {
            Self::Version { .. } | Self::Kind { .. } | Self::NotRegular { .. } | Self::TooLarge { .. } => false,
            // well sealed, hence written like this: not the disk's fault
            Self::Missing { .. } | Self::Content(_) => false,
            _ => true,
        }
    }
}
