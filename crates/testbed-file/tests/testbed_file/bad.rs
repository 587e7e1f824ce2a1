//! Error messages of testbed files: each rule has a file in `tests/bad`, with the expected message beside it. `BLESS=1
//! cargo test -p cotorra-testbed-file bad` writes the messages anew, to be read in the diff.

use std::{fs, path::Path};

#[test]
fn mistakes_have_a_place_and_a_correction() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bad");
    let bless = std::env::var_os("BLESS").is_some();
    let mut files: Vec<_> = fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "yaml"))
        .collect();
    files.sort();
    assert!(files.len() > 50, "the cases are there");
    for path in files {
        let name = path.file_name().unwrap().to_str().unwrap();
        let text = fs::read_to_string(&path).unwrap();
        let Err(wrong) = cotorra_testbed_file::parse(name, &text, &folder) else {
            panic!("{name} is accepted")
        };
        assert!(wrong.list.iter().all(|d| d.help.is_some()), "{name} says what would be right");
        let told = wrong.to_string();
        let expected = path.with_extension("txt");
        if bless {
            fs::write(expected, told).unwrap();
        } else {
            assert_eq!(told, fs::read_to_string(expected).unwrap_or_default(), "{name}");
        }
    }
}
