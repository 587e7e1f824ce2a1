//! Scenes as PDF 1.4: one page, with the font inside.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
};

use miniz_oxide::deflate::compress_to_vec_zlib;

use crate::{
    colour::Colour,
    font,
    geometry::Point,
    scene::{Cells, Item, Line, Scene, WIDTH},
    svg::number,
};

/// Name of the font; the letters before `+` mark a part of a font.
const FONT: &str = "FIGURE+Arimo";
/// Level of compression.
const LEVEL: u8 = 6;
/// Number of the first image's object; the others follow.
const FIRST_IMAGE: usize = 10;

/// A file whose objects are numbered from 1.
struct File {
    bytes: Vec<u8>,
    /// Offset of each object.
    offsets: Vec<usize>,
}

impl File {
    fn object(&mut self, content: &str) {
        self.offsets.push(self.bytes.len());
        let number = self.offsets.len();
        self.bytes.extend(format!("{number} 0 obj\n{content}\nendobj\n").bytes());
    }

    /// Adds a compressed stream; `more` are entries of its dictionary.
    fn stream(&mut self, more: &str, content: &[u8]) {
        let packed = compress_to_vec_zlib(content, LEVEL);
        self.offsets.push(self.bytes.len());
        let (number, length) = (self.offsets.len(), packed.len());
        let head = format!("{number} 0 obj\n<< /Length {length} /Filter /FlateDecode{more} >>\nstream\n");
        self.bytes.extend(head.bytes());
        self.bytes.extend(packed);
        self.bytes.extend(b"\nendstream\nendobj\n");
    }

    fn end(mut self) -> Vec<u8> {
        let (begin, size) = (self.bytes.len(), self.offsets.len() + 1);
        let mut end = format!("xref\n0 {size}\n0000000000 65535 f \n");
        for offset in self.offsets {
            end += &format!("{offset:010} 00000 n \n");
        }
        end += &format!("trailer\n<< /Size {size} /Root 1 0 R >>\nstartxref\n{begin}\n%%EOF\n");
        self.bytes.extend(end.bytes());
        self.bytes
    }
}

pub fn render(scene: &Scene) -> Vec<u8> {
    let letters: BTreeSet<char> = scene
        .items
        .iter()
        .filter_map(|item| if let Item::Text(text) = item { Some(text.text.chars()) } else { None })
        .flatten()
        .collect();
    // The bytes above 127 say that the file is binary.
    let mut file = File { bytes: b"%PDF-1.4\n%\xc3\xa4\xc3\xb6\n".to_vec(), offsets: Vec::new() };
    file.object("<< /Type /Catalog /Pages 2 0 R >>");
    file.object("<< /Type /Pages /Kids [3 0 R] /Count 1 >>");
    let cells: Vec<&Cells> = scene
        .items
        .iter()
        .filter_map(|item| if let Item::Cells(cells) = item { Some(cells) } else { None })
        .collect();
    let images: String = (0..cells.len()).map(|i| format!("/I{i} {} 0 R ", FIRST_IMAGE + i)).collect();
    let images = if images.is_empty() { images } else { format!(" /XObject << {images}>>") };
    file.object(&format!(
        "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {} {}] /Contents 4 0 R /Resources << /Font << /F 5 0 R >>{images} >> >>",
        number(WIDTH),
        number(scene.height)
    ));
    file.stream("", content(scene).as_bytes());
    file.object(&format!(
        "<< /Type /Font /Subtype /Type0 /BaseFont /{FONT} /Encoding /Identity-H /DescendantFonts [6 0 R] /ToUnicode 9 0 R >>"
    ));
    file.object(&format!(
        "<< /Type /Font /Subtype /CIDFontType2 /BaseFont /{FONT} /CIDToGIDMap /Identity /FontDescriptor 7 0 R /W [{}] \
         /CIDSystemInfo << /Registry (Adobe) /Ordering (Identity) /Supplement 0 >> >>",
        widths(&letters)
    ));
    file.object(&format!(
        "<< /Type /FontDescriptor /FontName /{FONT} /Flags 32 /FontBBox [-544 -303 1302 980] /ItalicAngle 0 /Ascent 905 \
         /Descent -212 /CapHeight 716 /StemV 80 /FontFile2 8 0 R >>"
    ));
    file.stream(&format!(" /Length1 {}", font::FILE.len()), font::FILE);
    file.stream("", to_unicode(&letters).as_bytes());
    for cells in cells {
        let (columns, rows) = (cells.columns, cells.rows());
        let head = format!(
            " /Type /XObject /Subtype /Image /Width {columns} /Height {rows} /ColorSpace /DeviceRGB /BitsPerComponent 8"
        );
        file.stream(&head, &cells.colours.iter().flat_map(|Colour(rgb)| *rgb).collect::<Vec<_>>());
    }
    file.end()
}

/// Returns the operators that draw the page.
fn content(scene: &Scene) -> String {
    // y grows upwards in PDF.
    let place = |(x, y): Point| format!("{} {}", number(x), number(scene.height - y));
    let path = |points: &[Point]| {
        let moves = points.iter().enumerate();
        let moves = moves.map(|(i, point)| place(*point) + if i == 0 { " m" } else { " l" });
        moves.collect::<Vec<_>>().join("\n")
    };
    let mut page = "1 j\n".to_owned();
    let mut image = 0;
    for item in &scene.items {
        let written = match item {
            Item::Area(points, colour) => {
                writeln!(page, "{} rg\n{}\nf", components(*colour), path(points))
            }
            Item::Cells(Cells { area, .. }) => {
                // An image fills the unit square.
                let (width, height) = (number(area.width()), number(area.height()));
                image += 1;
                let at = place((area.left, area.bottom));
                writeln!(page, "q\n{width} 0 0 {height} {at} cm\n/I{} Do\nQ", image - 1)
            }
            Item::Line(Line { points, colour, width, dashes }) => {
                let dashes = dashes.iter().map(|dash| number(*dash)).collect::<Vec<_>>().join(" ");
                let (colour, width) = (components(*colour), number(*width));
                writeln!(page, "{colour} RG\n{width} w\n[{dashes}] 0 d\n{}\nS", path(points))
            }
            Item::Text(text) => {
                let glyphs: String =
                    text.text.chars().map(|letter| format!("{:04x}", font::glyph(letter))).collect();
                let turn = if text.is_turned { "0 1 -1 0" } else { "1 0 0 1" };
                let (colour, size) = (components(text.colour), number(text.size));
                writeln!(
                    page,
                    "BT\n{colour} rg\n/F {size} Tf\n{turn} {} Tm\n<{glyphs}> Tj\nET",
                    place(text.start())
                )
            }
        };
        written.expect("writing into a string cannot fail");
    }
    page
}

fn components(Colour(rgb): Colour) -> String {
    rgb.map(|part| format!("{:.3}", f64::from(part) / 255.0)).join(" ")
}

/// Returns the widths of the letters' glyphs, in thousandths.
fn widths(letters: &BTreeSet<char>) -> String {
    let glyphs: BTreeSet<u16> = letters.iter().map(|letter| font::glyph(*letter)).collect();
    let width = |glyph: u16| f64::from(font::advance(glyph)) * 1000.0 / font::UNITS;
    glyphs
        .into_iter()
        .map(|glyph| format!("{glyph} [{}]", number(width(glyph))))
        .collect::<Vec<_>>()
        .join(" ")
}

/// Returns the map from glyphs back to letters, by which readers search and copy texts.
fn to_unicode(letters: &BTreeSet<char>) -> String {
    let glyphs: BTreeMap<u16, char> = letters
        .iter()
        .map(|letter| (font::glyph(*letter), *letter))
        .filter(|(glyph, _)| *glyph > 0)
        .collect();
    let mut map = "/CIDInit /ProcSet findresource begin\n12 dict begin\nbegincmap\n/CMapName /Letters def\n/CMapType 2 def\n\
                   1 begincodespacerange\n<0000> <ffff>\nendcodespacerange\n"
        .to_owned();
    // A block has at most 100 entries.
    for block in glyphs.into_iter().collect::<Vec<_>>().chunks(100) {
        map += &format!("{} beginbfchar\n", block.len());
        for (glyph, letter) in block {
            map += &format!("<{glyph:04x}> <{:04x}>\n", u32::from(*letter));
        }
        map += "endbfchar\n";
    }
    map + "endcmap\nCMapName currentdict /CMap defineresource pop\nend\nend\n"
}

#[cfg(test)]
mod tests {
    use miniz_oxide::inflate::decompress_to_vec_zlib;

    use super::*;
    use crate::{
        scene::{Anchor, tests::checkers},
        style::{ALERT, BLACK},
    };

    fn scene() -> Scene {
        let mut scene = Scene { height: 100.0, ..Scene::new() };
        scene.area(vec![(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)], ALERT);
        scene.line(vec![(1.0, 2.0), (3.5, 4.0)], BLACK, 0.6, &[4.0, 2.0]);
        scene.text((10.0, 20.0), "ab µ", 7.0, Anchor::Start, BLACK);
        scene.turned((10.0, 90.0), "b語", 7.0, Anchor::Start, BLACK);
        scene
    }

    /// Returns where the text begins in the file.
    fn find(file: &[u8], text: &str, from: usize) -> Option<usize> {
        let place = file[from..].windows(text.len()).position(|window| window == text.as_bytes());
        place.map(|place| from + place)
    }

    /// Returns the object with this number, through the table of offsets as readers do.
    fn object(file: &[u8], number: usize) -> &[u8] {
        let tail = String::from_utf8_lossy(&file[file.len() - 40..]).into_owned();
        let begin: usize = tail.lines().rev().nth(1).unwrap().parse().unwrap();
        let table = std::str::from_utf8(&file[begin..]).unwrap();
        let entry = table.lines().nth(2 + number).unwrap();
        assert_eq!(entry.len(), 19, "an entry has 20 bytes with its end of line");
        let offset: usize = entry[..10].parse().unwrap();
        let end = find(file, "endobj", offset).unwrap();
        let object = &file[offset..end];
        assert!(object.starts_with(format!("{number} 0 obj\n").as_bytes()), "{number}");
        object
    }

    fn unpack(object: &[u8]) -> Vec<u8> {
        let (begin, end) = (find(object, "stream\n", 0).unwrap() + 7, object.len() - "\nendstream\n".len());
        let head = String::from_utf8_lossy(&object[..begin]).into_owned();
        assert!(head.contains(&format!("/Length {} ", end - begin)), "{head}");
        decompress_to_vec_zlib(&object[begin..end]).unwrap()
    }

    #[test]
    fn every_object_is_where_the_table_says() {
        let file = render(&scene());
        assert!(file.starts_with(b"%PDF-1.4\n") && file.ends_with(b"%%EOF\n"));
        let text = |number| String::from_utf8_lossy(object(&file, number)).into_owned();
        assert!(text(1).contains("/Catalog") && text(2).contains("/Count 1"));
        assert!(text(3).contains("/MediaBox [0 0 241 100]"), "{}", text(3));
        assert!(
            text(5).contains("/Type0") && text(6).contains("/CIDFontType2") && text(7).contains("/FontFile2")
        );
        assert_eq!(unpack(object(&file, 8)), font::FILE);
    }

    #[test]
    fn the_page_holds_areas_lines_and_texts() {
        let file = render(&scene());
        let page = String::from_utf8(unpack(object(&file, 4))).unwrap();
        assert!(page.contains("0 100 m\n10 100 l\n10 90 l\nf\n"), "{page}");
        assert!(page.contains("0.6 w\n[4 2] 0 d\n1 98 m\n3.5 96 l\nS\n"), "{page}");
        let [a, b, micro] = ['a', 'b', 'µ'].map(font::glyph);
        let space = font::glyph(' ');
        let shown = format!("1 0 0 1 10 80 Tm\n<{a:04x}{b:04x}{space:04x}{micro:04x}> Tj");
        assert!(page.contains(&shown), "{page}");
        assert!(page.contains(&format!("0 1 -1 0 10 10 Tm\n<{b:04x}0000> Tj")), "{page}");
    }

    #[test]
    fn cells_are_images_in_their_place() {
        let mut scene = scene();
        scene.cells(checkers());
        scene.cells(Cells { columns: 1, ..checkers() });
        let file = render(&scene);
        let text = |number| String::from_utf8_lossy(object(&file, number)).into_owned();
        assert!(text(3).contains("/XObject << /I0 10 0 R /I1 11 0 R >>"), "{}", text(3));
        assert!(
            text(10).contains("/Width 2 /Height 1 ") && text(11).contains("/Width 1 /Height 2 "),
            "{}",
            text(11)
        );
        assert_eq!(unpack(object(&file, 10)), [0, 0, 0, 255, 255, 255]);
        let page = String::from_utf8(unpack(object(&file, 4))).unwrap();
        assert!(page.contains("q\n20 0 0 10 10 88 cm\n/I0 Do\nQ\n"), "{page}");
    }

    #[test]
    fn texts_can_be_searched_and_have_widths() {
        let file = render(&scene());
        let map = String::from_utf8(unpack(object(&file, 9))).unwrap();
        let micro = font::glyph('µ');
        assert!(map.contains("4 beginbfchar\n") && map.contains(&format!("<{micro:04x}> <00b5>")), "{map}");
        let fonts = String::from_utf8_lossy(object(&file, 6)).into_owned();
        assert!(fonts.contains(&format!("{} [556.15]", font::glyph('a'))), "{fonts}");
    }
}
