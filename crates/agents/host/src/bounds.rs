//! Bounds of lists.

/// Shortens a list to its first items, and returns the number of those left out.
pub(crate) fn keep<T>(list: &mut Vec<T>, most: usize) -> u32 {
    let left_out = list.len().saturating_sub(most);
    list.truncate(most);
    u32::try_from(left_out).unwrap_or(u32::MAX)
}
