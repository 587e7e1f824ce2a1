//! Stands in for utoipa, under its name, in all crates whose types and handlers an OpenAPI document describes.
//!
//! The documents are checked in, and the program serves them from there. It therefore needs nothing of utoipa: by default
//! `utoipa::ToSchema`, `utoipa::path` and the others expand to nothing, and take no time to build. Tests that derive the
//! documents, to compare them, depend on this crate with the feature `derive`. The same names are then utoipa's own.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

#[cfg(feature = "derive")]
pub mod documents;

#[cfg(not(feature = "derive"))]
pub use cotorra_openapi_inert::{IntoParams, IntoResponses, ToSchema, path};
#[cfg(feature = "derive")]
pub use utoipa::*;
