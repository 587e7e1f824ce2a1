//! Records of distributions: of times, and of sizes.

use std::time::Duration;

use cotorra_numbers::Distribution;

use crate::yaml::{
    Bytes,
    decode::{Amount, Either, Spanned, record},
};

/// Declares the records of a distribution of a quantity, and what they stand for in its base unit.
macro_rules! distributions {
    ($(#[doc = $doc:literal])* $name:ident, $lognormal:ident, $pareto:ident, $uniform:ident, $quantity:ty) => {
        record! {
            $(#[doc = $doc])*
            $name {
                /// Exponential, with this mean.
                exponential: Option<$quantity>,
                /// Lognormal.
                lognormal: Option<$lognormal>,
                /// Pareto, which has a heavy tail.
                pareto: Option<$pareto>,
                /// Uniform.
                uniform: Option<$uniform>,
            }
        }

        record! {
            /// A lognormal distribution.
            $lognormal {
                /// Mean.
                mean: $quantity,
                /// Deviation of the natural logarithm, from 0 to 10.
                sigma: Amount,
            }
        }

        record! {
            /// A Pareto distribution.
            $pareto {
                /// Mean.
                mean: $quantity,
                /// Shape, above 0; above 1 without `most`. Below 2, the variance would be infinite without `most`.
                shape: Amount,
                /// Largest value, above the mean. Without it, there is none.
                most: Option<$quantity>,
            }
        }

        record! {
            /// A uniform distribution.
            $uniform {
                /// Least value.
                from: $quantity,
                /// Largest value.
                to: $quantity,
            }
        }

        impl IsDistribution for Either<$quantity, $name> {
            fn kinds(&self) -> Vec<Option<Distribution>> {
                let figure = Figure::figure;
                let record = match self {
                    Either::Short(value) => return vec![Distribution::constant(figure(value))],
                    Either::Long(record) => record,
                };
                let $name { exponential, lognormal, pareto, uniform } = record;
                let exponential = exponential.as_ref().map(|mean| Distribution::exponential(figure(mean)));
                let lognormal = lognormal
                    .as_ref()
                    .map(|of| Distribution::lognormal(figure(&of.mean), of.sigma.0));
                let pareto = pareto.as_ref().map(|of| match &of.most {
                    None => Distribution::pareto(figure(&of.mean), of.shape.0),
                    Some(most) => Distribution::pareto_up_to(figure(&of.mean), of.shape.0, figure(most)),
                });
                let uniform =
                    uniform.as_ref().map(|of| Distribution::uniform(figure(&of.from), figure(&of.to)));
                [exponential, lognormal, pareto, uniform].into_iter().flatten().collect()
            }
        }
    };
}

distributions!(
    /// A distribution of times, by one of these keys. A plain time is always the same.
    TimesRecord, LognormalTimesRecord, ParetoTimesRecord, UniformTimesRecord, Duration
);
distributions!(
    /// A distribution of sizes, by one of these keys. A plain size is always the same.
    SizesRecord, LognormalSizesRecord, ParetoSizesRecord, UniformSizesRecord, Bytes
);

/// A value, or a record of its distribution.
pub(crate) trait IsDistribution {
    /// Returns the distribution of each key that is there; `None` for impossible figures. There should be one.
    fn kinds(&self) -> Vec<Option<Distribution>>;
}

/// A figure in its base unit: seconds or bytes.
trait Figure {
    fn figure(&self) -> f64;
}

impl Figure for Duration {
    fn figure(&self) -> f64 {
        self.as_secs_f64()
    }
}

impl Figure for Bytes {
    fn figure(&self) -> f64 {
        self.0 as f64
    }
}

/// A time, or a distribution of times.
pub(crate) type Times = Spanned<Either<Duration, TimesRecord>>;
/// A size, or a distribution of sizes.
pub(crate) type Sizes = Spanned<Either<Bytes, SizesRecord>>;
