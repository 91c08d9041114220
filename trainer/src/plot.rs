//! Figures, as SVG and PNG of the same drawing.

use std::path::Path;
use std::sync::Once;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, register_font};

use crate::error::ClientError;

/// Width and height in pixels.
const SIZE_PX: (u32, u32) = (900, 520);
const FONT: &str = "sans-serif";
const INK: RGBColor = RGBColor(40, 44, 52);
const FAINT: RGBColor = RGBColor(200, 204, 210);
/// Colour-blind safe (Okabe and Ito), one a group.
const COLOURS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];

/// One policy's episodes in a figure of returns.
#[derive(Debug, Clone)]
pub struct ReturnsGroup {
    /// Such as `expert`.
    pub label: String,
    /// Undiscounted returns.
    pub returns: Vec<f64>,
    /// Mean return.
    pub mean: f64,
    /// Its standard error, if it is known.
    pub standard_error: Option<f64>,
    /// Mean normalised score.
    pub score: f64,
}

/// Draws every episode's return as a dot, each group's mean as a bar with ± one standard error,
/// and D4RL's reference returns as lines; writes `path` with the extensions `svg` and `png`.
///
/// # Errors
/// [`ClientError::Plot`].
pub fn returns_figure(
    path: &Path,
    title: &str,
    references: &[(&str, f64)],
    groups: &[ReturnsGroup],
) -> Result<(), ClientError> {
    let values = || {
        let episodes = groups.iter().flat_map(|group| group.returns.iter().copied());
        episodes.chain(references.iter().map(|(_, value)| *value))
    };
    // The drawing library never comes back from an axis without an end.
    if groups.is_empty() || !values().all(f64::is_finite) {
        let message = "there is nothing to draw, or not everything is finite".to_owned();
        return Err(ClientError::Plot { path: path.to_path_buf(), message });
    }
    let range = values()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    provide_font();
    let (svg, png) = (path.with_extension("svg"), path.with_extension("png"));
    draw(&SVGBackend::new(&svg, SIZE_PX).into_drawing_area(), title, range, references, groups)
        .map_err(|message| ClientError::Plot { path: svg.clone(), message })?;
    draw(&BitMapBackend::new(&png, SIZE_PX).into_drawing_area(), title, range, references, groups)
        .map_err(|message| ClientError::Plot { path: png.clone(), message })
}

/// A font of our own, so that a machine without any draws the same picture.
fn provide_font() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // It fails only for a font that cannot be parsed; then drawing says so.
        let _ = register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT);
    });
}

fn draw<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    range: (f64, f64),
    references: &[(&str, f64)],
    groups: &[ReturnsGroup],
) -> Result<(), String> {
    draw_returns(area, title, range, references, groups).map_err(|error| error.to_string())
}

fn draw_returns<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    (low, high): (f64, f64),
    references: &[(&str, f64)],
    groups: &[ReturnsGroup],
) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
    let margin = 0.08 * (high - low).max(1.0);
    let count = groups.len() as f64;
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(area)
        .caption(title, (FONT, 22).into_font().color(&INK))
        .margin(16)
        .x_label_area_size(48)
        .y_label_area_size(72)
        .build_cartesian_2d(-0.5..count - 0.5, low - margin..high + margin)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .disable_x_axis()
        .light_line_style(WHITE)
        .bold_line_style(FAINT.mix(0.5))
        .axis_style(FAINT)
        .y_desc("return of an episode")
        .label_style((FONT, 15).into_font().color(&INK))
        .draw()?;
    for (name, value) in references {
        let line = [(-0.5, *value), (count - 0.5, *value)];
        chart.draw_series(DashedLineSeries::new(line, 6, 6, INK.mix(0.6).into()))?;
        let style = (FONT, 13).into_font().color(&INK).pos(Pos::new(HPos::Right, VPos::Bottom));
        chart.draw_series([Text::new((*name).to_owned(), (count - 0.52, *value), style)])?;
    }
    for (i, group) in groups.iter().enumerate() {
        let (x, colour) = (i as f64, COLOURS[i % COLOURS.len()]);
        let dots = group.returns.iter().enumerate().map(|(episode, &value)| {
            Circle::new((x + spread(episode), value), 4, colour.mix(0.45).filled())
        });
        chart.draw_series(dots)?;
        let error = group.standard_error.unwrap_or(0.0);
        let bar = |half_width: f64, y: f64, width: u32| {
            let line = vec![(x - half_width, y), (x + half_width, y)];
            PathElement::new(line, INK.stroke_width(width))
        };
        chart.draw_series([
            bar(0.3, group.mean, 3),
            bar(0.12, group.mean - error, 1),
            bar(0.12, group.mean + error, 1),
            PathElement::new(vec![(x, group.mean - error), (x, group.mean + error)], INK),
        ])?;
        let style = (FONT, 16).into_font().color(&INK).pos(Pos::new(HPos::Center, VPos::Top));
        let (pixel_x, _) = chart.backend_coord(&(x, low));
        let (_, height) = area.dim_in_pixel();
        let label = format!("{} (score {:.1})", group.label, group.score);
        area.draw(&Text::new(label, (pixel_x, height as i32 - 44), style))?;
    }
    area.present()
}

/// Where an episode's dot stands beside its group's middle: spread evenly by the golden ratio, the
/// same in every drawing.
fn spread(episode: usize) -> f64 {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    ((episode as f64 * GOLDEN).fract() - 0.5) * 0.4
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_files_are_drawn_and_show_what_they_were_given() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("returns");
        let group = ReturnsGroup {
            label: "expert".into(),
            returns: vec![1.0, 2.0, 4.0],
            mean: 7.0 / 3.0,
            standard_error: Some(0.9),
            score: 98.7,
        };
        let groups = [group];
        returns_figure(&path, "hopper-v0", &[("D4RL expert", 5.0)], &groups).unwrap();
        let svg = std::fs::read_to_string(path.with_extension("svg")).unwrap();
        for text in ["hopper-v0", "D4RL expert", "expert (score 98.7)"] {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(svg.matches("<circle").count(), 3);
        let png = std::fs::read(path.with_extension("png")).unwrap();
        assert!(png.starts_with(b"\x89PNG"));
        let missing = folder.path().join("absent/returns");
        assert!(returns_figure(&missing, "", &[], &groups).is_err());
        assert!(returns_figure(&path, "", &[], &[]).is_err());
        assert!(returns_figure(&path, "", &[("D4RL expert", f64::NAN)], &groups).is_err());
    }
}
