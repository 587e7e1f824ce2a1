use std::path::Path;

use super::*;

const TESTBED: &str = "name: site
wireless: { lab: {} }
nodes:
  R: { kind: radio_unit, position: [0, 0], channel: 1, tx_power: 20 dBm }
  S: { kind: radio_unit, position: [30, 0], channel: 1 }
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links:
  - { ends: [edge, [R, S]] }
";

fn testbed() -> Testbed {
    cotorra_testbed_file::parse("site", TESTBED, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"))
}

/// Readings of R at some distances along the x axis, by a formula without shadowing.
fn readings(distances: impl IntoIterator<Item = f64>) -> Vec<Reading> {
    let reading = |distance: f64| {
        // Free space at 1 m and 2412 MHz is 40.10 dB; 3 dB of reference loss; exponent 2.5.
        let free_space = PathLoss::FreeSpace.loss_db(1.0, 2412);
        let signal = 20.0 - free_space - 3.0 - 25.0 * distance.log10();
        let (place, radio_unit) = (Position::new(distance, 0.0), "R".to_owned());
        Reading { time_s: distance, place, radio_unit, signal: Dbm(signal) }
    };
    distances.into_iter().map(reading).collect()
}

fn refusal(readings: &[Reading]) -> String {
    fit_survey(&testbed(), readings, 1).unwrap_err().to_string()
}

#[test]
fn a_survey_without_shadowing_gives_its_formula_back() {
    let exact = readings((1..60).map(|i| 1.0 + f64::from(i) * 0.5));
    let fit = &fit_survey(&testbed(), &exact, 1).unwrap()["lab"];
    assert!((fit.reference_loss_db.value - 3.0).abs() < 1e-2, "{fit:#?}");
    assert!((fit.exponent.value - 2.5).abs() < 1e-2);
    assert!(fit.deviation_db.high < 0.1);
    assert_eq!((fit.readings, fit.radio_units, fit.wall_loss_db), (59, 1, None));
}

#[test]
fn too_few_readings_are_refused() {
    let few = readings((1..30).map(f64::from));
    assert_eq!(refusal(&few), "network `lab` has 29 readings: a fit needs 30 or more");
}

#[test]
fn readings_at_one_distance_are_refused() {
    let mut near = readings((0..40).map(|i| 10.0 + f64::from(i) * 0.2));
    assert_eq!(
        refusal(&near),
        "network `lab` was heard from 10.0 m to 17.8 m only, so its exponent is not known: walk from near a radio unit to 2 times \
         as far or more (distances within 1 m count as that)"
    );
    near.iter_mut().for_each(|reading| reading.place = Position::new(5.0, 0.0));
    assert!(refusal(&near).contains("was heard from 5.0 m to 5.0 m only"));
}

#[test]
fn unknown_radio_units_are_refused() {
    let mut unknown = readings((1..40).map(f64::from));
    unknown[3].radio_unit = "T".to_owned();
    assert_eq!(refusal(&unknown), "the testbed has no radio unit `T`; its radio units are: R, S");
}

#[test]
fn a_survey_is_read_with_its_columns_in_any_order() {
    let text = "# walk 1\nradio_unit, x, y, signal_dbm, time_s, z\nR, 1.5, -2, -60, 0.5, 1\n";
    let expected = Reading {
        time_s: 0.5,
        place: Position::new(1.5, -2.0).at_height(1.0),
        radio_unit: "R".to_owned(),
        signal: Dbm(-60.0),
    };
    assert_eq!(parse_survey(text), Ok(vec![expected]));
}

#[test]
fn wrong_surveys_are_rejected_in_place() {
    let header = "time_s,x,y,radio_unit,signal_dbm\n";
    for (text, expected) in [
        (String::new(), "the file is empty: it needs a header"),
        (header.to_owned(), "the survey has a header, but no readings"),
        (format!("{header}0,1,2,R,strong\n"), "line 2: `strong` is not a number from -200 to 60"),
        (format!("{header}0,1,nan,R,-50\n"), "line 2: `nan` is not a number from -1000000 to 1000000"),
        (format!("{header}0,1,2,R\n"), "line 2: it has 4 cells, but the header has 5"),
        (
            "x,y,radio_unit,signal_dbm\n".to_owned(),
            "line 1: there is no column `time_s`: write a header such as `time_s,x,y,radio_unit,signal_dbm`",
        ),
        (
            format!("{header}{}", "0,1,2,R,-50\n".repeat(MAX_READINGS + 1)),
            "line 20002: there are more than 20000 readings: keep every second one, or fewer",
        ),
    ] {
        assert_eq!(parse_survey(&text).unwrap_err().to_string(), expected);
    }
}
