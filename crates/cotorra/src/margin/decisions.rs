//! Decisions beside their alternatives: runs them, and describes the result.

use std::{num::NonZero, path::Path, process::ExitCode};

use cotorra_experiments::regret::{
    Compared, Decided, Examined, FILES, Recorded, Regret, RegretError, Regrets, Stood, Tried, Verdict,
};
use cotorra_testbed::{Manifest, inexact};

use super::{
    Error, MarginArgs, WhichDecision, again,
    cells::{LISTED, heads, paired, seconds, shown_p},
    distances, exit, open,
};
use crate::{
    output,
    progress::Progress,
    table::{Table, wrap},
    temporary::TemporaryFolder,
    testbed_file::Loaded,
    words::{self, count, of_them, signed},
};

/// Limit of a single seed.
const ONE_SEED: &str =
    "One seed does not tell whether a difference is more than chance: --seeds 10 gives intervals.\n";
/// Examines decisions of a run.
pub fn examine(
    args: &MarginArgs,
    Loaded { testbed, text, .. }: Loaded,
    seed: u64,
    jobs: NonZero<usize>,
    which: WhichDecision,
) -> miette::Result<ExitCode> {
    let number = match which {
        WhichDecision::All => None,
        WhichDecision::Number(number) => Some(number),
    };
    let fail = |error: RegretError| Error::from(error);
    let file = args.file.display().to_string();
    let inexact = inexact(&testbed);
    let regret = Regret::new((&file, testbed, text.clone()), &args.kpi, seed, args.until)
        .map_err(|error| fail(error.into()))?
        .seeds(args.seeds)
        .hold(args.hold);
    let place = args.out.clone().unwrap_or_else(|| regret.default_folder(Path::new("margins")));
    if args.dry_run {
        let folder = TemporaryFolder::new().map_err(Error::from)?;
        let recorded = match regret.record(&folder.path().join("run"), || true) {
            Ok(recorded) => recorded.expect("nobody stops it"),
            Err(error) => {
                // It may have a plug-in's log.
                folder.keep();
                return Err(fail(error).into());
            }
        };
        let twins = regret.count_twins(&recorded, number).map_err(fail)?;
        output::print(&(list(&recorded, number, twins) + &again(&place)))?;
        return Ok(ExitCode::SUCCESS);
    }
    let (interrupts, journal) = open(args, &place, (&text, inexact), seed)?;
    let folder = journal.path().join("run-as-it-was");
    let recorded = regret.record(&folder, || interrupts.try_recv().is_err());
    let Some(recorded) = recorded.map_err(fail)? else { return Ok(exit(false, 0)) };
    let mut progress = Progress::new(args.headless);
    let regrets = regret.examine(&recorded, number, &journal, jobs, |done, of| {
        progress.show(done, of);
        interrupts.try_recv().is_err()
    });
    progress.close();
    let regrets = regrets.map_err(fail)?;
    regrets.write(&journal).map_err(Error::from)?;
    if regrets.complete {
        Manifest::complete(journal.path()).map_err(Error::from)?;
    }
    output::print(&describe(&regrets, journal.path()))?;
    Ok(exit(regrets.complete, regrets.void))
}

/// Lists the decisions of a run, and their alternatives. So many twins are run, too.
fn list(recorded: &[Recorded], number: Option<NonZero<usize>>, twins: usize) -> String {
    let chosen = |decided: &&Decided| number.is_none_or(|number| number.get() == decided.number);
    let first = recorded.first().into_iter().flat_map(|run| &run.decided);
    let decided: Vec<_> = first.filter(chosen).collect();
    let wanted = |its: &&Decided| number.is_none() || decided.iter().any(|decided| its.is_like(decided));
    let all = recorded.iter().flat_map(|run| &run.decided).filter(wanted);
    let runs: usize = all.map(|decided| decided.alternatives.len()).sum();
    let mut table = Table::new(">><<<<");
    table.row(["decision", "at", "by", "of", "to", "alternatives"].map(str::to_owned));
    for decided in decided.iter().take(LISTED) {
        let name = |alternative: &cotorra_experiments::regret::Alternative| {
            named(&alternative.target, alternative.instead.is_none())
        };
        let alternatives: Vec<_> = decided.alternatives.iter().map(name).collect();
        table.row(heads(decided).into_iter().chain([alternatives.join(", ")]));
    }
    let more = decided.len().saturating_sub(LISTED);
    let more = if more > 0 { format!("  and {more} more\n") } else { String::new() };
    let decisions = count(decided.len(), "decision");
    let seeds = match recorded {
        [first, _, ..] => format!(" with {}; those of seed {}:", count(recorded.len(), "seed"), first.seed),
        _ => String::new(),
    };
    let twins = if twins > 0 { format!(" and {}", count(twins, "twin")) } else { String::new() };
    format!(
        "{decisions}, {} with alternatives{twins}{seeds}\n\n{}{more}",
        count(runs, "run"),
        table.render("  ")
    )
}

fn named(target: &str, stays: bool) -> String {
    if stays { format!("{target} (no change)") } else { target.to_owned() }
}

fn describe(regrets: &Regrets, folder: &Path) -> String {
    let Regrets { seed, seeds, services, examined, compared, distances, .. } = regrets;
    let Regrets { complete, runs, resumed, again, void, .. } = regrets;
    let of_them = of_them(*resumed, *void);
    let services: Vec<_> = services.iter().map(ToString::to_string).collect();
    let twins = if distances.is_empty() { "" } else { " and twins" };
    let runs = count(*runs, "run");
    let which = match seeds {
        1 => format!("seed {seed}"),
        seeds => format!("{seeds} seeds from {seed} on"),
    };
    let mut text = format!(
        "{runs} with alternatives{twins}{of_them}; samples of {} from each decision on, {which}\n{again}\n",
        services.join(", ")
    );
    text += &match &examined[..] {
        _ if *seeds > 1 => over_seeds(examined, compared),
        [one] => single(one) + ONE_SEED,
        all => overview(all) + ONE_SEED,
    };
    text += &distances::describe(distances, examined, *seeds);
    if !complete {
        text += "\nThe comparison was stopped; the same command resumes it.\n";
    }
    text + &format!("\n{}/\n  {}\n", folder.display(), FILES.join("  "))
}

/// Describes one decision with all alternatives.
fn single(Examined { decided, stood, tried, regret_kept, regret_ms, .. }: &Examined) -> String {
    let Decided { number, at, plugin, reason, .. } = decided;
    let reason = reason.as_ref().map(|reason| format!(": {reason}")).unwrap_or_default();
    let what = format!(
        "Decision {number} at {}: {plugin} chose {} for {}{reason}",
        seconds(*at),
        decided.chosen(),
        decided.subject()
    );
    let mut table = Table::new("<<>>>>>>");
    let heads = ["", "to", "kept, %", "late", "median, ms", "cost", "migrations", "handovers"];
    table.row(heads.map(str::to_owned));
    let number = |number: Option<usize>| number.map_or_else(|| "-".to_owned(), |number| number.to_string());
    let figures = |of: &Stood| {
        let cost = of.cost.map_or_else(|| "-".to_owned(), |cost| format!("{cost:.2}"));
        [kept(of, stood), number(of.late), median(of), cost, number(of.migrations), number(of.handovers)]
    };
    table.row(["decision".to_owned(), decided.chosen()].into_iter().chain(figures(stood)));
    for Tried { target, stays, stood, refused, void } in tried {
        let figures = match (stood, refused, void) {
            (Some(stood), ..) => figures(stood),
            (None, refused, void) => {
                let mut cells = [const { String::new() }; 6];
                cells[0] = match void {
                    Some(void) => void.to_string(),
                    None => format!("rejected: {}", refused.as_deref().unwrap_or_default()),
                };
                cells
            }
        };
        table.row(["alternative".to_owned(), named(target, *stays)].into_iter().chain(figures));
    }
    let regret = match (regret_kept, regret_ms) {
        (Some(regret), regret_ms) => {
            let median = regret_ms.map(|ms| format!(", and {} ms at the median", signed(ms)));
            format!("Regret: {} percentage points{}.", signed(regret * 100.0), median.unwrap_or_default())
        }
        _ if tried.iter().any(|tried| tried.void.is_some()) => {
            format!("The regret is unknown: a run is void. {}", words::logs())
        }
        _ => "No alternative can be compared.".to_owned(),
    };
    format!("{}\n{}\n{regret}\n", wrap(&what, "", 100), table.render("  "))
}

/// Lists the alternatives of a decision over several seeds, or of several decisions the best ones.
fn over_seeds(examined: &[Examined], compared: &[Compared]) -> String {
    let best = Compared::best(compared);
    let listed: Vec<_> = if best.len() == 1 { compared.iter().collect() } else { best.clone() };
    let mut table = Table::new(">><<<<>>>>>>>");
    let of_decision = ["decision", "at", "by", "of", "to", "alternative", "seeds", "kept, points", "p"];
    let more = ["median, ms", "late", "cost", "migrations"];
    table.row(of_decision.into_iter().chain(more));
    for of in listed.iter().take(LISTED) {
        let Compared { number, seed, target, stays, pairs, undone, kept, .. } = of;
        let decided = examined.iter().find(|its| its.seed == *seed && its.decided.number == *number);
        let of_decision = decided.map(|its| heads(&its.decided)).unwrap_or_default();
        let p = kept.and_then(|kept| kept.p).map_or_else(|| "-".to_owned(), shown_p);
        let undone = if *undone > 0 { format!(", no end in {undone}") } else { String::new() };
        let cells = [
            named(target, *stays),
            format!("{pairs}{undone}"),
            paired(*kept, 100.0),
            p,
            paired(of.service_time_p50_ms, 1.0),
            paired(of.late, 1.0),
            paired(of.cost, 1.0),
            paired(of.migrations, 1.0),
        ];
        table.row(of_decision.into_iter().chain(cells));
    }
    let mut text = table.render("  ");
    if listed.len() > LISTED {
        text += &format!("  and {} more in {}\n", listed.len() - LISTED, FILES[1]);
    }
    let of = count(best.len(), "decision");
    let decisions = |wanted: Verdict| {
        let decisions = compared.chunk_by(|a, b| (a.seed, a.number) == (b.seed, b.number));
        decisions.filter(|its| its.iter().any(|its| its.verdict() == wanted)).count()
    };
    let (better, too_few) = (decisions(Verdict::Better), decisions(Verdict::TooFew));
    let few = match too_few {
        0 => String::new(),
        few => format!(" In {few}, there are fewer than three seeds with the decision, too few to tell."),
    };
    let sentence = format!(
        "An alternative kept more samples, by more than chance, in {better} of {of}.{few} Figures are means of the \
         alternative less the decision with the same seed, with 95 % intervals by Student's t; p is corrected for the number of alternatives, \
         {}, by Holm.",
        compared.len()
    );
    text + "\n" + &wrap(&sentence, "", 100)
}

/// Lists decisions, each with its best alternative.
fn overview(examined: &[Examined]) -> String {
    let mut table = Table::new(">><<<>>>>>");
    let heads_of =
        ["decision", "at", "by", "of", "to", "kept, %", "median, ms", "regret, points", "regret, ms", "cost"];
    table.row(heads_of.map(str::to_owned));
    for Examined { decided, stood, tried, regret_kept, regret_ms, regret_cost, .. } in
        examined.iter().take(LISTED)
    {
        let void = tried.iter().find_map(|tried| tried.void.as_ref());
        let without = void.map_or_else(|| "-".to_owned(), ToString::to_string);
        let figure = |figure: Option<f64>| figure.map_or_else(|| without.clone(), signed);
        let figures = [
            kept(stood, stood),
            median(stood),
            figure(regret_kept.map(|regret| regret * 100.0)),
            figure(*regret_ms),
            figure(*regret_cost),
        ];
        table.row(heads(decided).into_iter().chain(figures));
    }
    let mut text = table.render("  ");
    if examined.len() > LISTED {
        text += &format!("  and {} more in {}\n", examined.len() - LISTED, FILES[0]);
    }
    let regretted = examined.iter().filter(|its| its.regret_kept.is_some_and(|regret| regret > 0.0)).count();
    text + &format!(
        "\nAn alternative kept more samples in {regretted} of {}.\n",
        count(examined.len(), "decision")
    )
}

/// Returns the share of samples kept, and whether a walk did not end that ended with the decision.
fn kept(stood: &Stood, with_decision: &Stood) -> String {
    let kept = stood.kept.map_or_else(|| "-".to_owned(), |kept| format!("{:.2}", kept * 100.0));
    if stood.walked || !with_decision.walked { kept } else { format!("{kept}, a walk does not end") }
}

fn median(stood: &Stood) -> String {
    stood.service_time_p50_ms.map_or_else(|| "-".to_owned(), |median| format!("{median:.2}"))
}
