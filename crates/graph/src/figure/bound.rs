//! Bounds on figures, such as `service_time p95 <= 15 ms`: the KPIs of services.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Deserializer, Serialize, de::Error as _};

use super::{
    Figure,
    declared::{Better, Declared, FIGURES, FigureKind, Total},
    statistic::Statistic,
    unit::Unit,
};
use crate::id::{NodeId, ServiceId};

/// A bound on a figure. As text: the figure, with its subject behind colons; its statistic, if it has samples; `<=` or `>=`;
/// the limit with its unit.
///
/// A subject that is left out is the service of the KPI, or its robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(into = "String")]
pub struct Bound {
    figure: &'static Declared,
    of: Vec<String>,
    statistic: Option<Statistic>,
    comparison: Comparison,
    limit: f64,
    unit: &'static str,
}

/// A figure with its subject and, if it has samples, its statistic.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Measure {
    /// A statistic of samples.
    Of(Figure, Statistic),
    /// One number.
    Total(Total),
}

/// The side of a limit on which a value must be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Comparison {
    AtMost,
    AtLeast,
}

impl Comparison {
    const fn as_str(self) -> &'static str {
        match self {
            Self::AtMost => "<=",
            Self::AtLeast => ">=",
        }
    }
}

/// A text that is not a bound.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidBound {
    /// It has another form.
    #[error(
        "`{0}` is not a bound: write a figure, `<=` or `>=`, and a limit, such as `service_time p95 <= 15 ms`"
    )]
    Form(String),
    /// No figure has that name.
    #[error("there is no figure `{0}`: there are {names}", names = names())]
    Figure(String),
    /// The figure has samples, and nothing says which statistic is bounded.
    #[error("`{0}` has many values: name one of {statistics}, such as `{0} {statistic} {comparison} …`",
        statistics = statistics(), statistic = usual(.0).0, comparison = usual(.0).1)]
    NoStatistic(&'static str),
    /// There is no such statistic.
    #[error("`{1}` is no statistic of `{0}`: there are {statistics}", statistics = statistics())]
    Statistic(&'static str, String),
    /// The figure is one number.
    #[error("`{0}` is one number: leave out `{1}`")]
    OneNumber(&'static str, String),
    /// The limit is no number with a unit of the figure.
    #[error("`{given}` is no limit of `{figure}`: write {example}", example = example(figure))]
    Limit {
        /// The figure.
        figure: &'static str,
        /// The limit.
        given: String,
    },
    /// The figure's subject is not complete, or has too many names.
    #[error("`{given}` does not say of what it is: write `{figure}{of}`", of = of(figure))]
    Subject {
        /// The figure.
        figure: &'static str,
        /// The figure with its subject.
        given: String,
    },
}

impl InvalidBound {
    /// Returns the name that was not found, and all that there are.
    pub fn unknown_figure(&self) -> Option<(&str, impl Iterator<Item = &'static str>)> {
        match self {
            Self::Figure(name) => Some((name, FIGURES.iter().map(|figure| figure.name))),
            _ => None,
        }
    }
}

fn names() -> String {
    FIGURES.iter().map(|figure| figure.name).collect::<Vec<_>>().join(", ")
}

fn statistics() -> String {
    Statistic::ALL.map(Statistic::as_str).join(", ")
}

fn usual(figure: &str) -> (&'static str, &'static str) {
    match Declared::named(figure).map(|figure| figure.better) {
        Some(Better::Higher) => ("min", ">="),
        _ => ("p95", "<="),
    }
}

fn of(figure: &str) -> String {
    Declared::named(figure).map(|figure| format!(":{}", figure.of)).unwrap_or_default()
}

fn example(figure: &str) -> String {
    match Declared::named(figure).map(|figure| figure.unit) {
        None | Some(Unit::Number) => "a number without a unit, such as `3`".to_owned(),
        Some(unit) => {
            let units: Vec<_> = unit.written().iter().map(|(unit, _)| *unit).collect();
            format!("a number in {}, such as `10 {}`", units.join(", "), units[0])
        }
    }
}

impl Bound {
    /// Requires at least this share of a figure that is a share.
    pub fn at_least(total: Total, share: f64) -> Self {
        let percent = share * 100.0;
        // The shortest number that gives this share, where rounding leaves one.
        let rounded = (percent * 1e9).round() / 1e9;
        let figure = total.declared();
        Self {
            figure,
            of: Vec::new(),
            statistic: None,
            comparison: Comparison::AtLeast,
            limit: rounded,
            unit: "%",
        }
    }

    /// Returns the figure's declaration.
    pub fn figure(&self) -> &'static Declared {
        self.figure
    }

    /// Returns the limit in the figure's unit.
    pub fn limit(&self) -> f64 {
        let units = self.figure.unit.written().iter();
        let factor = units.clone().find(|(unit, _)| *unit == self.unit).map_or(1.0, |(_, factor)| *factor);
        // The decimal point moves without rounding: 99.9 % is 0.999, which neither a product nor a quotient gives.
        let exponent = factor.log10();
        let moved = (exponent.fract() == 0.0).then(|| format!("{}e{exponent}", self.limit).parse().ok());
        moved.flatten().unwrap_or(self.limit * factor)
    }

    /// Whether a value keeps the bound. What was not measured does not.
    pub fn holds(&self, value: Option<f64>) -> bool {
        value.is_some_and(|value| match self.comparison {
            Comparison::AtMost => value <= self.limit(),
            Comparison::AtLeast => value >= self.limit(),
        })
    }

    /// Returns the bounded figure with its subject, where names that are left out are those of a service and its robot.
    ///
    /// # Errors
    /// [`InvalidBound::Subject`] if other names are missing, or there are too many.
    pub fn measure(&self, service: &ServiceId, robot: &NodeId) -> Result<Measure, InvalidBound> {
        let given = self.subject();
        let invalid = || InvalidBound::Subject { figure: self.figure.name, given: given.clone() };
        let Some(statistic) = self.statistic else {
            let total = Total::named(self.figure.name).filter(|_| self.of.is_empty());
            return total.map(Measure::Total).ok_or_else(invalid);
        };
        let names: Vec<_> = self.figure.of.split(':').filter(|name| !name.is_empty()).collect();
        let mut of = self.of.iter().map(String::as_str);
        let is_whole = of.len() == names.len();
        let mut text = self.figure.name.to_owned();
        for name in names {
            let found = match name {
                "SERVICE" if !is_whole => Some(service.as_str()),
                "ROBOT" if !is_whole => Some(robot.as_str()),
                "DIRECTION" => Some(of.next().unwrap_or("forward")),
                _ => of.next(),
            };
            text += ":";
            text += found.ok_or_else(invalid)?;
        }
        if of.next().is_some() {
            return Err(invalid());
        }
        text.parse().map(|figure| Measure::Of(figure, statistic)).map_err(|_| invalid())
    }

    /// Returns the figure with the subject as it was given.
    fn subject(&self) -> String {
        [self.figure.name].into_iter().chain(self.of.iter().map(String::as_str)).collect::<Vec<_>>().join(":")
    }
}

impl fmt::Display for Bound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.subject())?;
        if let Some(statistic) = self.statistic {
            write!(f, " {}", statistic.as_str())?;
        }
        let space = if self.unit.is_empty() { "" } else { " " };
        write!(f, " {} {}{space}{}", self.comparison.as_str(), self.limit, self.unit)
    }
}

impl FromStr for Bound {
    type Err = InvalidBound;
    fn from_str(text: &str) -> Result<Self, InvalidBound> {
        let form = || InvalidBound::Form(text.chars().take(80).collect());
        let comparisons = [Comparison::AtMost, Comparison::AtLeast];
        let divided = |its: Comparison| Some((its, text.split_once(its.as_str())?));
        let (comparison, (left, right)) = comparisons.into_iter().find_map(divided).ok_or_else(form)?;
        let words: Vec<_> = left.split_whitespace().collect();
        let (name, statistic) = match words[..] {
            [name] => (name, None),
            [name, statistic] => (name, Some(statistic)),
            _ => return Err(form()),
        };
        let mut names = name.split(':');
        let name = names.next().unwrap_or_default();
        let short = |text: &str| text.chars().take(80).collect::<String>();
        let figure = Declared::named(name).ok_or_else(|| InvalidBound::Figure(short(name)))?;
        let named = |word: &str| Statistic::ALL.into_iter().find(|its| its.as_str() == word);
        let statistic = match (figure.kind, statistic) {
            (FigureKind::Total, None) => None,
            (FigureKind::Total, Some(word)) => return Err(InvalidBound::OneNumber(figure.name, short(word))),
            (FigureKind::Samples, None) => return Err(InvalidBound::NoStatistic(figure.name)),
            (FigureKind::Samples, Some(word)) => {
                Some(named(word).ok_or_else(|| InvalidBound::Statistic(figure.name, short(word)))?)
            }
        };
        let right = right.trim();
        let end = right.find(|c: char| !matches!(c, '0'..='9' | '.' | '-')).unwrap_or(right.len());
        let (number, unit) = right.split_at(end);
        let limit = number.parse().ok().filter(|limit: &f64| limit.is_finite());
        let mut units = figure.unit.written().iter();
        let unit = units.find_map(|(its, _)| (*its == unit.trim()).then_some(*its));
        let (limit, unit) = limit
            .zip(unit)
            .ok_or_else(|| InvalidBound::Limit { figure: figure.name, given: short(right) })?;
        let of = names.map(str::to_owned).collect();
        Ok(Self { figure, of, statistic, comparison, limit, unit })
    }
}

// The derived one takes the reference to the registry for one into the text.
impl<'de> Deserialize<'de> for Bound {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}

impl From<Bound> for String {
    fn from(bound: Bound) -> Self {
        bound.to_string()
    }
}

#[cfg(test)]
mod tests {
    use proptest::{prelude::*, sample::select};

    use super::*;
    use crate::LinkQuantity;

    fn bound(text: &str) -> Bound {
        text.parse().unwrap()
    }

    fn measure(text: &str) -> Result<String, InvalidBound> {
        let of = bound(text).measure(&"navigation".parse().unwrap(), &"r1".parse().unwrap())?;
        Ok(match of {
            Measure::Of(figure, statistic) => format!("{figure} {}", statistic.as_str()),
            Measure::Total(total) => total.as_str().to_owned(),
        })
    }

    proptest! {
        #[test]
        fn written_bounds_are_read_back(
            figure in select(FIGURES.to_vec()),
            statistic in select(Statistic::ALL.to_vec()),
            at_most in any::<bool>(),
            limit in -1e6..1e6_f64,
            unit in any::<prop::sample::Index>(),
        ) {
            let statistic = (figure.kind == FigureKind::Samples).then_some(statistic);
            let comparison = if at_most { Comparison::AtMost } else { Comparison::AtLeast };
            let (unit, _) = *unit.get(figure.unit.written());
            let of = figure.of.split(':').filter(|name| !name.is_empty()).map(str::to_lowercase).collect();
            let bound = Bound { figure, of, statistic, comparison, limit, unit };
            prop_assert_eq!(bound.to_string().parse(), Ok(bound));
        }
    }

    #[test]
    fn each_figure_is_declared_once_and_read_by_its_name() {
        for (i, figure) in FIGURES.iter().enumerate() {
            assert!(FIGURES[..i].iter().all(|other| other.name != figure.name), "{}", figure.name);
            assert!(figure.about.ends_with('.'), "{}", figure.name);
        }
    }

    #[test]
    fn a_value_at_the_limit_holds_and_what_was_not_measured_does_not() {
        for (text, limit) in [
            ("service_time p95 <= 15 ms", 15.0),
            ("service_time max<=0.5 s", 500.0),
            ("answered >= 99.9 %", 0.999),
            ("localization_error p95 <= 10 cm", 0.1),
            ("cost <= 3", 3.0),
            ("throughput:a-b min >= 2 Mbit/s", 2e6),
        ] {
            let bound = bound(text);
            assert_eq!(bound.limit(), limit, "{text}");
            assert!(bound.holds(Some(limit)) && !bound.holds(None), "{text}");
            let (low, high) = (bound.holds(Some(limit - 1e-6)), bound.holds(Some(limit + 1e-6)));
            assert_eq!(
                (low, high),
                if text.contains("<=") { (true, false) } else { (false, true) },
                "{text}"
            );
        }
        assert_eq!(Bound::at_least(Total::Kept, 0.999), bound("kept >= 99.9 %"));
        assert_eq!(Bound::at_least(Total::Reliability, 0.99999).to_string(), "reliability >= 99.999 %");
    }

    #[test]
    fn subjects_that_are_left_out_are_those_of_the_service() {
        let is = |text: &str, expected: &str| assert_eq!(measure(text), Ok(expected.to_owned()), "{text}");
        is("service_time p95 <= 15 ms", "service_time:navigation:r1 p95");
        is("service_time:other:r2 p95 <= 15 ms", "service_time:other:r2 p95");
        is("time_part:vnf mean <= 1 ms", "time_part:vnf:navigation:r1 mean");
        is("handover_gap max <= 50 ms", "handover_gap:r1 max");
        is("localization_error:r2 max <= 1 m", "localization_error:r2 max");
        is("signal:R1 min >= -70 dBm", "signal:r1:R1 min");
        is("queue:a-b max <= 10 packets", "queue:a-b:forward max");
        is("queue:a-b:backward max <= 10 packets", "queue:a-b:backward max");
        is("lateness_p99 max <= 1 ms", "lateness_p99 max");
        is("answered >= 99 %", "answered");
        for text in
            ["queue max <= 3 packets", "queue:a:b:c max <= 3 packets", "x:r1:r2 max <= 3 m", "kept:a >= 9 %"]
        {
            let error = measure(text).unwrap_err().to_string();
            assert!(error.contains("does not say of what it is"), "{error}");
        }
        let link = "a-b".parse().unwrap();
        let figure = Figure::Link(link, crate::Direction::Forward, LinkQuantity::Queue);
        let of = bound("queue:a-b max <= 9 packets").measure(&"s".parse().unwrap(), &"r".parse().unwrap());
        assert_eq!(of, Ok(Measure::Of(figure, Statistic::Max)));
    }

    #[test]
    fn wrong_bounds_are_rejected_with_what_would_be_right() {
        for (text, expected) in [
            ("fast", "`fast` is not a bound: write a figure, `<=` or `>=`, and a limit"),
            ("service_time p95 < 15 ms", "is not a bound"),
            ("a b c <= 15 ms", "is not a bound"),
            ("weather <= 3", "there is no figure `weather`: there are delay, throughput"),
            (
                "service_time <= 15 ms",
                "name one of mean, min, p50, p95, p99, max, such as `service_time p95 <= …`",
            ),
            ("nearest_obstacle >= 1 m", "such as `nearest_obstacle min >= …`"),
            ("service_time p90 <= 15 ms", "`p90` is no statistic of `service_time`"),
            ("answered p95 >= 99 %", "`answered` is one number: leave out `p95`"),
            ("answered >= 0.99", "write a number in %, such as `10 %`"),
            ("service_time p95 <= 15", "write a number in ms, s, min, us, µs, ns, such as `10 ms`"),
            ("service_time p95 <= 15 m", "`15 m` is no limit of `service_time`"),
            ("cost <= 3 ms", "a number without a unit, such as `3`"),
            ("cost <= ", "`` is no limit of `cost`"),
        ] {
            let error = text.parse::<Bound>().unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
