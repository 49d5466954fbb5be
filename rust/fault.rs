//! Format version and size limit of state files, and the reasons to refuse one.

use safetensors::Dtype;

/// Version of the format: written, and the only one read.
pub const VERSION: u64 = 2;

/// Largest file, 16 GiB; 1 GiB where addresses have 32 bits.
pub const MAX_BYTES: u64 = if usize::BITS < 64 { 1 << 30 } else { 1 << 34 };

/// Why a file is not accepted as a state file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of each variant says what its fields are")]
pub enum Fault {
    #[error("is not a state file: its first bytes are wrong")]
    Foreign,
    #[error("is damaged: it is empty or begins with zeros, so its data never reached the disk")]
    Blank,
    #[error("is damaged: it ends within its header, after {found} bytes")]
    Truncated { found: usize },
    #[error("is damaged: it has {found} bytes instead of the {declared} in its header")]
    Length { declared: u64, found: usize },
    #[error("is damaged: its contents do not match the checksum in its header")]
    Checksum,
    #[error("is damaged: its header cannot be read: {0}")]
    Header(String),
    #[error("has format version {found}, but this release reads version {VERSION}")]
    Version { found: u64 },
    #[error("holds a state of kind '{found}', not '{expected}'")]
    Kind { found: String, expected: String },
    #[error("has a section '{name}' of type {dtype} and {dimensions} dimensions: must be U8, U64 or F64 and one")]
    Element { name: String, dtype: Dtype, dimensions: usize },
    #[error("has a header that differs from the one for its contents")]
    Canonical,
    #[error("has invalid contents: {0}")]
    Content(String),
    #[error("is {what}, not a regular file")]
    NotRegular { what: &'static str },
    #[error("has {found} bytes, more than the {MAX_BYTES} that are read")]
    TooLarge { found: u64 },
}

impl Fault {
    /// Whether the file may once have been good, so that the previous generation may be loaded instead.
    pub(crate) fn is_damage(&self) -> bool {
        match self {
            Self::Version { .. } | Self::Kind { .. } | Self::NotRegular { .. } | Self::TooLarge { .. } => false,
            // the digest is right, so it was written like this: not a fault of the disk
            Self::Content(_) => false,
            _ => true,
        }
    }
}
