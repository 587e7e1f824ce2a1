//! Conditional requests (RFC 9110, clause 13): comparison of entity tags with `If-Match` and `If-None-Match`.

/// Whether `If-Match` permits a change: no header, `*`, or the resource's tag. Weak tags never match.
pub(crate) fn may_change(if_match: Option<&str>, etag: &str) -> bool {
    if_match.is_none_or(|header| tags(header).any(|tag| tag == "*" || tag == etag))
}

/// Whether `If-None-Match` shows that the requester has the resource already: `*`, or its tag, weak or not.
pub(crate) fn is_known(if_none_match: Option<&str>, etag: &str) -> bool {
    let strong = |tag: &str| tag.strip_prefix("W/").unwrap_or(tag) == etag;
    if_none_match.is_some_and(|header| tags(header).any(|tag| tag == "*" || strong(tag)))
}

/// Splits a list of tags at commas. This service's own tags contain none.
fn tags(header: &str) -> impl Iterator<Item = &str> {
    header.split(',').map(str::trim)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matching_tags_permit_changes_and_save_answers() {
        let etag = "\"1-2\"";
        for (header, changes, known) in [
            (None, true, false),
            (Some("*"), true, true),
            (Some("\"1-2\""), true, true),
            (Some("\"1-1\", \"1-2\""), true, true),
            (Some("W/\"1-2\""), false, true),
            (Some("\"1-1\""), false, false),
            (Some("1-2"), false, false),
            (Some(""), false, false),
        ] {
            assert_eq!((may_change(header, etag), is_known(header, etag)), (changes, known), "{header:?}");
        }
    }
}
