//! Fits a testbed to measurements of a real site: the radio to a signal survey, and links to times of packets.
//!
//! Texts and captures go in, and estimates with 95 % intervals come out, with the settings that put them into a testbed file. It
//! opens no files and measures nothing itself. All randomness comes from a seed, so that a calibration can be repeated.
//!
//! [`fit_survey`] fits path loss, walls and shadowing of a wireless network, [`fit_handovers`] the phases of its handovers,
//! [`fit_fading`] its fading, and [`fit_interference`] what others send on its channels.
//! [`Recorded`] finds signals and handovers in the events of a run. [`Calibration::new`] fits a part of all measurements, and tests
//! surveys and links on the other part. [`fit_walk`] fits a testbed to the service times of a walk. Measurements that do not
//! determine a value give a wide interval, a [`CalibrateError`] or a note.
#![forbid(unsafe_code)]

mod calibration;
mod capture;
mod compare;
mod csv;
mod error;
mod estimate;
mod handovers;
mod interference;
mod jitter;
mod loss;
mod matched;
mod path;
mod recorded;
mod report;
mod round_trips;
mod settings;
mod survey;
mod times;
mod walk;

pub use self::{
    calibration::{
        Calibration, LinkCalibration, LinkMeasurement, Measurements, NetworkCalibration, Options,
        PathCalibration,
    },
    capture::{MAX_CAPTURE, one_way_of_captures, round_trips_of_capture},
    compare::{Comparison, Figures, Prediction, Predictor, compare},
    csv::{CsvRow, MAX_LINES, csv_rows},
    error::CalibrateError,
    estimate::Estimate,
    handovers::{HandoverFit, LEAST_HANDOVERS, fit_handovers},
    interference::{
        ChannelSurvey, Counters, InterferenceFit, MeasuredChannel, PresenceFit, fit_interference,
        parse_channel_survey,
    },
    loss::LossFit,
    path::{LEAST_ARRIVED, PathFit, fit_path},
    recorded::{HandoverTime, Recorded},
    report::markdown,
    round_trips::{parse_round_trips, parse_stamp},
    settings::{FittedSetting, calibrated_text},
    survey::{
        FadingFit, MAX_READINGS, Reading, SignalPrediction, SignalPredictor, SurveyComparison, SurveyFit,
        compare_survey, fit_fading, fit_survey, parse_survey, split_survey,
    },
    times::{Means, OneWay, PacketTimes},
    walk::{
        LEAST_IN_REGION, Region, RegionFit, ScanFit, SimulatedSample, WalkData, WalkFit, WalkSample, fit_walk,
    },
};
