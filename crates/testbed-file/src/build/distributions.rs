//! Distributions.

use cotorra_numbers::Distribution;

use super::builder::Builder;
use crate::{records::IsDistribution, yaml::decode::Spanned};

impl Builder<'_> {
    /// Returns the distribution that a value or a record stands for. Its mean is above 0, unless it `may_be_zero`.
    pub(super) fn distribution(
        &mut self,
        record: &Spanned<impl IsDistribution>,
        may_be_zero: bool,
    ) -> Option<Distribution> {
        let kinds = record.value.kinds();
        let [kind] = kinds[..] else {
            self.sink.error(&record.span, format!("a distribution of {} kinds", kinds.len())).help(
                "write one of `exponential`, `lognormal`, `pareto` and `uniform`, or a plain value, which is always the same",
            );
            return None;
        };
        let Some(distribution) = kind else {
            self.sink.error(&record.span, "no distribution has these figures").help(
                "a mean is above 0, `sigma` from 0 to 10, `from` at most `to`, `most` above the mean, and a `shape` above 1, or \
                 above 0 with `most`",
            );
            return None;
        };
        if distribution.mean() == 0.0 && !may_be_zero {
            self.sink.error(&record.span, "this is always zero").help("write more than that");
            return None;
        }
        Some(distribution)
    }
}
