//! A camera whose images cross the emulated network to a program, beside navigation.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::fs;

use crate::harness::{Run, project_file, wait_until};

/// Returns the images that the detector logged: number, size, bytes, checksum and mean brightness.
fn received(run: &Run) -> Vec<(u64, String, u64, u32, f64)> {
    let log = fs::read_to_string(run.folder.join("logs/vnfs/detector.log")).unwrap_or_default();
    // The last line may be incomplete.
    let whole = log.rfind('\n').map_or("", |end| &log[..end]);
    let lines = whole.lines().filter_map(|line| {
        let [number, size, bytes, checksum, mean] =
            line.strip_prefix("front ")?.split(' ').collect::<Vec<_>>()[..]
        else {
            panic!("{log}")
        };
        Some((
            number.parse().unwrap(),
            size.to_owned(),
            bytes.parse().unwrap(),
            checksum.parse().unwrap(),
            mean.parse().unwrap(),
        ))
    });
    lines.collect()
}

/// Returns the CRC-32 of ISO 3309, like zlib.
fn crc32(bytes: &[u8]) -> u32 {
    let byte = |crc: u32, byte: &u8| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ if crc & 1 == 1 { 0xedb8_8320 } else { 0 })
    };
    !bytes.iter().fold(u32::MAX, byte)
}

#[test]
fn a_program_receives_whole_images_while_the_robot_is_navigated() {
    let mut run = Run::start_beside(&project_file("testbeds/camera.yaml"), &["--until", "5min"]);
    wait_until(|| received(&run).len() >= 30);
    let images = received(&run);
    assert!(images.is_sorted_by(|a, b| a.0 < b.0), "{images:?}");
    for (_, size, bytes, _, mean) in &images {
        assert_eq!((size.as_str(), *bytes), ("320x240", 320 * 240));
        assert!((20.0..220.0).contains(mean), "a corridor is neither dark nor white: {mean}");
    }
    // The robot drives, so that its images change.
    wait_until(|| {
        let images = received(&run);
        images.last().unwrap().3 != images[0].3
    });
    // The run keeps the same images that crossed the network.
    let (number, _, _, checksum, _) = received(&run).pop().unwrap();
    let (kept, header) = run.bytes(&format!("/api/v1/robots/robot/sensors/front/{number}"));
    assert_eq!((header("x-cotorra-format").as_str(), header("x-cotorra-width").as_str()), ("mono8", "320"));
    assert_eq!((kept.len(), crc32(&kept)), (320 * 240, checksum));
    let last = run.get("/api/v1/robots/robot/sensors")[0]["last"]["data"].clone();
    assert_eq!(
        (&last["format"], &last["width"], &last["height"]),
        (&"mono8".into(), &320.into(), &240.into())
    );
    assert!(last["sequence"].as_u64().unwrap() >= images.last().unwrap().0);
    run.signal("INT");
    let (summary, _) = run.report();
    let samples = |name: &str| summary[name].as_u64().unwrap();
    assert!(samples("unanswered") < samples("samples") / 2, "{summary}");

    // The run's folder holds the detector, and the folder that this may read.
    let place = tempfile::tempdir().unwrap();
    let kept = place.path().join("kept");
    fs::rename(&run.folder, &kept).unwrap();
    let text = fs::read_to_string(kept.join("testbed.yaml")).unwrap();
    assert!(text.contains("readable: [files/python]") && !text.contains(".."), "{text}");
    let mut again = run.another(&kept.join("testbed.yaml"), &["--until", "5min"]);
    wait_until(|| !received(&again).is_empty());
    again.signal("INT");
    again.wait();
}
