//! The page that shows a testbed in a browser, as static files.
//!
//! [`files`] has everything that the page consists of; whoever serves them serves cotorra's HTTP API under the same origin.
//! The page uses nothing else. This crate knows neither the API nor a server.
//!
//! Plain modules of JavaScript, without a framework and without a build: what is in `page/` is what a browser gets.
#![forbid(unsafe_code)]

/// The Content-Security-Policy of the page: only its own files and its own API, and no other page around it.
pub const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
    img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; \
    require-trusted-types-for 'script'";

/// A file of the page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct File {
    /// Path on the server.
    pub path: &'static str,
    /// Its contents.
    pub bytes: &'static [u8],
}

impl File {
    /// Returns the media type.
    pub fn content_type(&self) -> &'static str {
        match self.path.rsplit('.').next() {
            Some("js") => "text/javascript; charset=utf-8",
            Some("css") => "text/css; charset=utf-8",
            Some("svg") => "image/svg+xml",
            _ => "text/html; charset=utf-8",
        }
    }

    /// Returns the entity tag, which differs for other contents (FNV-1a).
    pub fn etag(&self) -> String {
        let step = |sum: u64, byte: &u8| (sum ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        format!("\"{:016x}\"", self.bytes.iter().fold(0xcbf2_9ce4_8422_2325, step))
    }
}

macro_rules! files {
    ($($path:literal),* $(,)?) => {
        [$(File { path: concat!("/dashboard/", $path), bytes: include_bytes!(concat!("../page/", $path)) }),*]
    };
}

/// Returns the files of the dashboard. The first is the page itself.
pub fn files() -> Vec<File> {
    with_modules(include_bytes!("../page/index.html"))
}

/// Returns the files of the editor of testbed files. The first is the page itself.
pub fn editor() -> Vec<File> {
    with_modules(include_bytes!("../page/edit.html"))
}

/// Returns a page with the modules that pages load.
fn with_modules(page: &'static [u8]) -> Vec<File> {
    let modules = files![
        "action_panel.js",
        "actions.js",
        "api.js",
        "app.js",
        "canvas.js",
        "charts.js",
        "complete.js",
        "coverage.js",
        "detail.js",
        "dom.js",
        "edit.js",
        "format.js",
        "kept.js",
        "icon.svg",
        "map.js",
        "moment.js",
        "palette.js",
        "pgm.js",
        "plot.js",
        "raster.js",
        "robots.js",
        "scan.js",
        "series.js",
        "state.js",
        "style.css",
        "time_axis.js",
        "time_control.js",
        "timeline.js",
        "topology.js",
        "units.js",
    ];
    std::iter::once(File { path: "/", bytes: page }).chain(modules).collect()
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeSet, fs, path::Path};

    use super::*;

    #[test]
    fn every_file_of_the_page_is_served() {
        let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("page");
        let name = |entry: std::io::Result<fs::DirEntry>| entry.unwrap().file_name().into_string().unwrap();
        let there: BTreeSet<_> = fs::read_dir(page).unwrap().map(name).collect();
        let name = |path: &'static str| path.rsplit('/').next().unwrap_or_default();
        let served = files().into_iter().map(|file| name(file.path)).filter(|name| !name.is_empty());
        let served = served.chain(["index.html", "edit.html"]).map(str::to_owned).collect();
        assert_eq!(there, served);
    }

    #[test]
    fn the_page_is_small_and_names_no_other_host() {
        let bytes: usize = files().iter().map(|file| file.bytes.len()).sum();
        assert!(bytes < 1 << 20, "{bytes} bytes");
        for file in files().into_iter().chain(editor()) {
            let text = std::str::from_utf8(file.bytes).unwrap();
            let others = text
                .match_indices("://")
                .map(|(at, _)| &text[at.saturating_sub(6)..(at + 40).min(text.len())]);
            let others: Vec<_> = others.filter(|other| !other.contains("www.w3.org/2000/svg")).collect();
            assert!(others.is_empty(), "{}: {others:?}", file.path);
        }
    }

    #[test]
    fn an_entity_tag_follows_the_contents() {
        let file = |bytes| File { path: "/dashboard/x.js", bytes };
        assert_eq!(file(b"a").etag(), file(b"a").etag());
        assert_ne!(file(b"a").etag(), file(b"b").etag());
    }
}
