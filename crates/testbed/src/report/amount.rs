//! Small amounts as people read them.

/// Writes an amount with two decimals, and a small one with as many as show two digits.
pub(super) fn amount(amount: f64) -> String {
    if amount == 0.0 || amount >= 0.1 {
        return format!("{amount:.2}");
    }
    let decimals = (1.0 - amount.log10().floor()).min(9.0) as usize;
    format!("{amount:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_amounts_show_two_digits() {
        let amounts = [0.0, 12.0, 0.1, 0.0123, 0.000_045_6].map(amount);
        assert_eq!(amounts, ["0.00", "12.00", "0.10", "0.012", "0.000046"]);
    }
}
