//! The derives and the attribute of utoipa that cotorra's types and handlers have. Here they expand to nothing.
//!
//! `cotorra-openapi` says when these stand in for utoipa's.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

use proc_macro::TokenStream;

/// Derives nothing.
#[proc_macro_derive(ToSchema, attributes(schema))]
pub fn to_schema(_: TokenStream) -> TokenStream {
    TokenStream::new()
}

/// Derives nothing.
#[proc_macro_derive(IntoParams, attributes(into_params, param))]
pub fn into_params(_: TokenStream) -> TokenStream {
    TokenStream::new()
}

/// Derives nothing.
#[proc_macro_derive(IntoResponses, attributes(response))]
pub fn into_responses(_: TokenStream) -> TokenStream {
    TokenStream::new()
}

/// Leaves a handler as it is.
#[proc_macro_attribute]
pub fn path(_: TokenStream, handler: TokenStream) -> TokenStream {
    handler
}
