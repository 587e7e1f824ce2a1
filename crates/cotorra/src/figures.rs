//! Arguments for files of figures.

use std::path::PathBuf;

use clap::Args;
use cotorra_figure::Format;

/// Formats of the figure beside a run, a sweep or an experiment.
#[derive(Debug, Args)]
pub struct FigureArgs {
    /// Write the figure also as pdf or png, beside svg; as in pdf,png
    ///
    /// A PDF is 8.5 cm wide, as a column of a paper, with its font inside. A PNG has 432 pixels to the inch.
    #[arg(long = "figure", value_name = "FORMATS", value_delimiter = ',')]
    formats: Vec<Format>,
}

impl FigureArgs {
    /// Returns the formats beside SVG.
    pub fn further(&self) -> impl Iterator<Item = Format> {
        Format::ALL.into_iter().filter(|format| *format != Format::Svg && self.formats.contains(format))
    }

    /// Lists the further files of a figure, each after two spaces.
    pub fn files(&self, stem: &str) -> String {
        self.further().map(|format| format!("  {stem}.{format}")).collect()
    }
}

/// Parses the name of a figure's file.
pub fn parse_figure_file(name: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(name);
    match Format::of(&path) {
        Some(_) => Ok(path),
        None => Err("the file's name must end with .svg, .pdf or .png".to_owned()),
    }
}
