//! Scenes as SVG 1.1.

use std::fmt::Write as _;

use base64::{Engine as _, engine::general_purpose::STANDARD};

use crate::{
    colour::Colour,
    font,
    geometry::Point,
    png,
    scene::{Anchor, Cells, Item, Line, Scene, WIDTH},
};

/// Pixels of a point where a browser shows the figure at its own size.
const PIXELS: f64 = 3.0;

pub fn render(scene: &Scene) -> String {
    let (wide, high) = (number(WIDTH * PIXELS), number(scene.height * PIXELS));
    let view = format!("0 0 {} {}", number(WIDTH), number(scene.height));
    // All of these fonts have the same widths. Where none is installed, `textLength` keeps the widths.
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{wide}\" height=\"{high}\" viewBox=\"{view}\" \
         font-family=\"Arimo, Liberation Sans, Arial, Helvetica, sans-serif\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
    );
    for item in &scene.items {
        let written = match item {
            Item::Area(area, colour) => {
                writeln!(svg, "<polygon points=\"{}\" fill=\"{}\"/>", points(area), hex(*colour))
            }
            Item::Cells(cells) => writeln!(svg, "{}", image(cells)),
            Item::Line(Line { points: line, colour, width, dashes }) => {
                let dashes = dashes.iter().map(|dash| number(*dash)).collect::<Vec<_>>().join(" ");
                let dashes =
                    if dashes.is_empty() { dashes } else { format!(" stroke-dasharray=\"{dashes}\"") };
                writeln!(
                    svg,
                    "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{}\" \
                     stroke-linejoin=\"round\"{dashes}/>",
                    points(line),
                    hex(*colour),
                    number(*width)
                )
            }
            Item::Text(text) => {
                let (x, y) = (number(text.at.0), number(text.at.1));
                let anchor = match text.anchor {
                    Anchor::Start => "start",
                    Anchor::Middle => "middle",
                    Anchor::End => "end",
                };
                let turn = if text.is_turned {
                    format!(" transform=\"rotate(-90 {x} {y})\"")
                } else {
                    String::new()
                };
                writeln!(
                    svg,
                    "<text x=\"{x}\" y=\"{y}\" font-size=\"{}\" text-anchor=\"{anchor}\" fill=\"{}\" \
                     textLength=\"{}\" lengthAdjust=\"spacingAndGlyphs\"{turn}>{}</text>",
                    number(text.size),
                    hex(text.colour),
                    number(font::width(&text.text, text.size)),
                    escape(&text.text)
                )
            }
        };
        written.expect("writing into a string cannot fail");
    }
    svg + "</svg>\n"
}

/// Returns cells as a PNG picture inside the file. Programs must not smooth their edges.
fn image(cells: &Cells) -> String {
    let area = &cells.area;
    let [x, y, width, height] = [area.left, area.top, area.width(), area.height()].map(number);
    format!(
        "<image x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" preserveAspectRatio=\"none\" \
         style=\"image-rendering:optimizeSpeed;image-rendering:pixelated\" \
         xmlns:xlink=\"http://www.w3.org/1999/xlink\" xlink:href=\"data:image/png;base64,{}\"/>",
        STANDARD.encode(png::encode(cells))
    )
}

/// Formats a length with two decimals at most.
pub fn number(value: f64) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

fn points(points: &[Point]) -> String {
    points.iter().map(|(x, y)| format!("{},{}", number(*x), number(*y))).collect::<Vec<_>>().join(" ")
}

fn hex(Colour([red, green, blue]): Colour) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// Escapes markup. Control characters are not allowed in XML at all.
fn escape(text: &str) -> String {
    let mut escaped = String::new();
    for letter in text.chars() {
        match letter {
            '&' => escaped += "&amp;",
            '<' => escaped += "&lt;",
            '>' => escaped += "&gt;",
            control if control.is_control() || ('\u{fffe}'..='\u{ffff}').contains(&control) => {
                escaped.push(' ')
            }
            other => escaped.push(other),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{scene::tests::checkers, style::BLACK};

    #[test]
    fn cells_are_a_picture_that_is_not_smoothed() {
        let cells = checkers();
        let mut scene = Scene { height: 20.0, ..Scene::new() };
        scene.cells(cells.clone());
        let svg = render(&scene);
        assert!(svg.contains("x=\"10\" y=\"2\" width=\"20\" height=\"10\""), "{svg}");
        let (_, data) = svg.split_once("base64,").unwrap();
        assert_eq!(STANDARD.decode(data.split('"').next().unwrap()).unwrap(), png::encode(&cells));
    }

    #[test]
    fn texts_are_escaped_and_numbers_are_short() {
        let mut scene = Scene { height: 20.0, ..Scene::new() };
        scene.text((1.0, 2.005), "a<b>&\u{1}c", 7.0, Anchor::Middle, BLACK);
        scene.turned((1.0, 2.0), "up", 6.5, Anchor::End, BLACK);
        scene.line(vec![(0.0, -0.001), (1.5, 2.25)], Colour([255, 0, 10]), 0.4, &[4.0, 1.5]);
        let svg = render(&scene);
        assert!(svg.contains(">a&lt;b&gt;&amp; c</text>") && svg.contains("rotate(-90 1 2)"), "{svg}");
        assert!(svg.contains("points=\"0,0 1.5,2.25\"") && svg.contains("stroke=\"#ff000a\""), "{svg}");
        assert!(svg.contains("stroke-dasharray=\"4 1.5\""), "{svg}");
    }
}
