//! What the contenders' walks spent: prices and energies for each hour.

use cotorra_experiments::sweep::Spent;
use cotorra_testbed::{DataTable, Summary};
use serde::Serialize;

use super::CONTENDERS;

/// What a contender's walk spent.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpentByWalk {
    pub contender: &'static str,
    /// Prices, that of everything first; none without a currency.
    pub bill: Vec<Spent>,
    /// Energies, that of everything first; none if no node has a power.
    pub energy: Vec<Spent>,
}

/// Returns what the walks of the contenders spent; nothing if the testbed has neither prices nor powers.
pub(super) fn by_contender(walks: [&Summary; 2]) -> Vec<SpentByWalk> {
    let spent = CONTENDERS.into_iter().zip(walks).map(|(contender, summary)| SpentByWalk {
        contender: contender.name,
        bill: Spent::prices(summary),
        energy: Spent::energies(summary),
    });
    spent.filter(|its| !its.bill.is_empty() || !its.energy.is_empty()).collect()
}

/// Returns a row for each price and each mean power, with a column for each contender; `None` without any.
pub(super) fn table(walks: &[SpentByWalk]) -> Option<DataTable> {
    let first = walks.first()?;
    let heads = ["spent in an hour"].into_iter().chain(walks.iter().map(|its| its.contender));
    let mut table = DataTable::new(heads).right_after(1);
    let mut rows = |what: &str, of_walk: fn(&SpentByWalk) -> &[Spent]| {
        for (place, row) in of_walk(first).iter().enumerate() {
            let cells = walks.iter().map(|its| {
                let its = of_walk(its).get(place).filter(|its| its.of == row.of);
                its.map_or("-".to_owned(), |its| format!("{:.2} {}", its.per_hour, its.unit_per_hour()))
            });
            table.row([format!("{what} of {}", row.of)].into_iter().chain(cells));
        }
    };
    rows("price", |its| &its.bill);
    rows("mean power", |its| &its.energy);
    Some(table)
}
