//! Statistics of samples.

/// A statistic of samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Statistic {
    /// Mean.
    Mean,
    /// Least.
    Min,
    /// Median.
    P50,
    /// 95th percentile.
    P95,
    /// 99th percentile.
    P99,
    /// Greatest.
    Max,
}

impl Statistic {
    /// All statistics.
    pub const ALL: [Self; 6] = [Self::Mean, Self::Min, Self::P50, Self::P95, Self::P99, Self::Max];

    /// Returns its name.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Min => "min",
            Self::P50 => "p50",
            Self::P95 => "p95",
            Self::P99 => "p99",
            Self::Max => "max",
        }
    }
}
