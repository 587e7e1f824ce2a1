//! Handles of disciplines and classes in the kernel's traffic control.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Handle of a discipline (minor 0) or a class, such as `c070:1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Handle(pub(crate) u32);

impl Handle {
    /// Parent of an interface's root discipline.
    pub(crate) const ROOT: Self = Self(0xffff_ffff);
    /// Parent of the ingress discipline.
    pub(crate) const INGRESS: Self = Self(0xffff_fff1);
    /// Parent of the ingress filters.
    pub(crate) const ARRIVING: Self = Self(0xffff_fff2);
    /// The ingress discipline.
    pub(crate) const INGRESS_DISCIPLINE: Self = Self::new(0xffff, 0);
    /// Root discipline of this crate. Its major number marks what this crate created.
    pub(crate) const OURS: Self = Self::new(0xc070, 0);

    pub(crate) const fn new(major: u16, minor: u16) -> Self {
        Self((major as u32) << 16 | minor as u32)
    }

    pub(crate) const fn major(self) -> u16 {
        (self.0 >> 16) as u16
    }

    pub(crate) const fn minor(self) -> u16 {
        self.0 as u16
    }

    /// Returns the handle of our class with this number.
    pub(crate) const fn class(number: u16) -> Self {
        Self::new(Self::OURS.major(), number)
    }

    /// Returns the handle of the discipline in our class with this number.
    pub(crate) const fn leaf(number: u16) -> Self {
        Self::new(Self::OURS.major() + number, 0)
    }
}

impl fmt::Display for Handle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (*self, self.minor()) {
            (Self::ROOT, _) => f.write_str("root"),
            (Self::INGRESS, _) => f.write_str("ingress"),
            (_, 0) => write!(f, "{:x}:", self.major()),
            (_, minor) => write!(f, "{:x}:{minor:x}", self.major()),
        }
    }
}
