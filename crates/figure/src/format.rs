//! File formats of figures.

use std::{fmt, path::Path, str::FromStr};

use crate::{pdf, png, scene::Scene, svg};

/// File format of a figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    Svg,
    Pdf,
    Png,
}

impl Format {
    pub const ALL: [Self; 3] = [Self::Svg, Self::Pdf, Self::Png];

    /// Returns the format of a file by the ending of its name.
    pub fn of(file: &Path) -> Option<Self> {
        file.extension()?.to_str()?.parse().ok()
    }

    /// Returns its name, which is also the ending of its files.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Svg => "svg",
            Self::Pdf => "pdf",
            Self::Png => "png",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for Format {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|format| format.as_str() == name);
        found.ok_or_else(|| "formats of figures are svg, pdf and png".to_owned())
    }
}

impl Scene {
    /// Writes the scene as a file of this format.
    pub fn render(&self, format: Format) -> Vec<u8> {
        match format {
            Format::Svg => svg::render(self).into_bytes(),
            Format::Pdf => pdf::render(self),
            Format::Png => png::render(self),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_have_the_names_of_their_files() {
        for format in Format::ALL {
            assert_eq!(format.as_str().parse(), Ok(format));
            assert_eq!(Format::of(&Path::new("a.b").with_extension(format.as_str())), Some(format));
        }
        assert!("gif".parse::<Format>().unwrap_err().contains("svg, pdf and png"));
    }
}
