//! Order of names for readers.

/// Sorts names for readers: digits count as a number, so that `R2` is before `R10`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Natural {
    parts: Vec<Part>,
    /// Tells names apart that differ in leading zeros alone.
    name: String,
}

/// A part of a name. Of two numbers without leading zeros, the one with more digits is greater.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    Number { digits: usize, figures: String },
    Text(String),
}

impl Natural {
    /// Returns the place of a name in the order.
    pub fn of(name: &str) -> Self {
        let mut parts = Vec::new();
        let mut rest = name;
        while let Some(first) = rest.chars().next() {
            let is_number = first.is_ascii_digit();
            let end = rest.find(|c: char| c.is_ascii_digit() != is_number).unwrap_or(rest.len());
            let (part, after) = rest.split_at(end);
            let figures = part.trim_start_matches('0');
            parts.push(match is_number {
                true => Part::Number { digits: figures.len(), figures: figures.to_owned() },
                false => Part::Text(part.to_owned()),
            });
            rest = after;
        }
        Self { parts, name: name.to_owned() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_in_names_count_as_numbers() {
        let sorted =
            ["10", "R", "R1", "R01", "R2", "R2-9", "R2-10", "R10", "R100", "a99999999999999999999999"];
        let mut names = sorted;
        names.reverse();
        names.sort_by_cached_key(|name| Natural::of(name));
        assert_eq!(names, ["10", "R", "R01", "R1", "R2", "R2-9", "R2-10", "R10", "R100", sorted[9]]);
    }
}
