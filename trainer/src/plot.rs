//! Figures, as SVG and PNG of the same drawing: panels with curves, points and error bars.

use std::ops::Range;
use std::path::Path;
use std::sync::Once;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};

use crate::error::ClientError;

/// Width and height of a panel in pixels.
const PANEL_PX: (u32, u32) = (520, 440);
/// Height of the figure's title and of the legend.
const TITLE_PX: u32 = 46;
const LEGEND_PX: u32 = 40;
const FONT: &str = "sans-serif";
const INK: RGBColor = RGBColor(40, 44, 52);
const FAINT: RGBColor = RGBColor(200, 204, 210);
/// Colour-blind safe (Okabe and Ito), one a series.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(110, 110, 110),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];

/// A point with its uncertainty; an axis without one has `None`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Where.
    pub x: f64,
    /// Where.
    pub y: f64,
    /// Low and high end, in x.
    pub x_interval: Option<(f64, f64)>,
    /// Low and high end, in y.
    pub y_interval: Option<(f64, f64)>,
}

impl Point {
    /// Without intervals.
    #[must_use]
    pub fn new(x: f64, y: f64) -> Self {
        Self { x, y, x_interval: None, y_interval: None }
    }
}

/// What belongs together in a panel.
#[derive(Debug, Clone)]
pub struct Series {
    /// In the legend; equal names have equal colours in all panels.
    pub label: String,
    /// In the order in which a line joins them.
    pub points: Vec<Point>,
    /// True: a curve, whose y intervals are a band. False: dots with error bars.
    pub is_curve: bool,
}

/// One pair of axes.
#[derive(Debug, Clone)]
pub struct Panel {
    /// Above it.
    pub title: String,
    /// Below it.
    pub x_label: String,
    /// Beside it.
    pub y_label: String,
    /// y on a logarithmic axis; numbers that are not positive are left out.
    pub is_y_log: bool,
    /// What is drawn.
    pub series: Vec<Series>,
}

/// Draws `panels`, up to three side by side; writes `path` with the extensions `svg` and `png`.
///
/// # Errors
/// [`ClientError::Plot`], also for a panel without anything finite to draw.
pub fn figure(path: &Path, title: &str, panels: &[Panel]) -> Result<(), ClientError> {
    let (svg, png) = (path.with_extension("svg"), path.with_extension("png"));
    let failed = |path: &Path, message: String| ClientError::Plot { path: path.into(), message };
    if panels.is_empty() {
        return Err(failed(&svg, "there is nothing to draw".into()));
    }
    // The drawing library never comes back from an axis without an end: such numbers are dropped.
    let panels: Vec<Panel> = panels.iter().map(drawable).collect();
    if let Some(empty) = panels.iter().find(|panel| panel.series.is_empty()) {
        return Err(failed(&svg, format!("nothing in panel {:?} is finite", empty.title)));
    }
    provide_font();
    let (rows, columns) = grid(panels.len());
    let height = PANEL_PX.1 * rows as u32 + TITLE_PX + LEGEND_PX;
    let size = (PANEL_PX.0 * columns as u32, height);
    draw(&SVGBackend::new(&svg, size).into_drawing_area(), title, &panels)
        .map_err(|error| failed(&svg, error.to_string()))?;
    draw(&BitMapBackend::new(&png, size).into_drawing_area(), title, &panels)
        .map_err(|error| failed(&png, error.to_string()))
}

/// Rows and columns of so many panels.
fn grid(panels: usize) -> (usize, usize) {
    let columns = if panels <= 3 { panels } else { panels.div_ceil(2).min(3) };
    (panels.div_ceil(columns), columns)
}

/// A font of our own, so that a machine without any draws the same picture.
fn provide_font() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // It fails only for a font that cannot be parsed; then drawing says so.
        let _ = register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT);
    });
}

/// The panel without points that have no place on its axes.
fn drawable(panel: &Panel) -> Panel {
    let has_place = |x: f64, y: f64| x.is_finite() && y.is_finite() && (!panel.is_y_log || y > 0.0);
    let interval = |(low, high): (f64, f64), least: f64| {
        (low.is_finite() && high.is_finite()).then(|| (low.max(least), high.max(least)))
    };
    let positive = if panel.is_y_log { f64::MIN_POSITIVE } else { f64::NEG_INFINITY };
    let series = panel.series.iter().filter_map(|series| {
        let points: Vec<Point> = series
            .points
            .iter()
            .filter(|point| has_place(point.x, point.y))
            .map(|point| Point {
                x_interval: point.x_interval.and_then(|ends| interval(ends, f64::NEG_INFINITY)),
                // On a logarithmic axis an end at 0 would be infinitely far away.
                y_interval: point
                    .y_interval
                    .and_then(|ends| interval(ends, positive.max(low_end(point.y, panel)))),
                ..*point
            })
            .collect();
        (!points.is_empty()).then(|| Series { points, ..series.clone() })
    });
    Panel { series: series.collect(), ..panel.clone() }
}

/// The lowest place that an interval's end may have beside a point.
fn low_end(y: f64, panel: &Panel) -> f64 {
    if panel.is_y_log { y / 1e3 } else { f64::NEG_INFINITY }
}

type Drawn<B> = Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

fn draw<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    panels: &[Panel],
) -> Drawn<B> {
    area.fill(&WHITE)?;
    let (head, rest) = area.split_vertically(TITLE_PX);
    head.titled(title, (FONT, 22).into_font().color(&INK))?;
    let labels = labels(panels);
    let (rows, columns) = grid(panels.len());
    let (body, foot) = rest.split_vertically(PANEL_PX.1 * rows as u32);
    for (part, panel) in body.split_evenly((rows, columns)).iter().zip(panels) {
        draw_panel(part, panel, &labels)?;
    }
    legend(&foot, &labels)?;
    area.present()
}

/// Each label once, in the order in which they come.
fn labels(panels: &[Panel]) -> Vec<&str> {
    let mut labels: Vec<&str> = Vec::new();
    for series in panels.iter().flat_map(|panel| &panel.series) {
        if !labels.contains(&series.label.as_str()) {
            labels.push(&series.label);
        }
    }
    labels
}

fn colour(labels: &[&str], label: &str) -> RGBColor {
    let index = labels.iter().position(|other| *other == label).unwrap_or(0);
    COLOURS[index % COLOURS.len()]
}

fn legend<B: DrawingBackend>(area: &DrawingArea<B, Shift>, labels: &[&str]) -> Drawn<B> {
    let style = (FONT, 17).into_font().color(&INK);
    let mut x = 72;
    for label in labels {
        area.draw(&Rectangle::new([(x, 10), (x + 16, 24)], colour(labels, label).filled()))?;
        area.draw(&Text::new((*label).to_owned(), (x + 24, 8), style.clone()))?;
        let (width, _) = area.estimate_text_size(label, &style)?;
        x += width as i32 + 60;
    }
    Ok(())
}

fn draw_panel<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    panel: &Panel,
    labels: &[&str],
) -> Drawn<B> {
    let ends = |interval: Option<(f64, f64)>, value: f64| {
        let (low, high) = interval.unwrap_or((value, value));
        [value, low, high]
    };
    let points = || panel.series.iter().flat_map(|series| &series.points);
    let x = span(points().flat_map(|point| ends(point.x_interval, point.x)), false);
    let y = span(points().flat_map(|point| ends(point.y_interval, point.y)), panel.is_y_log);
    let mut builder = ChartBuilder::on(area);
    builder
        .caption(&panel.title, (FONT, 18).into_font().color(&INK))
        .margin(12)
        .x_label_area_size(48)
        .y_label_area_size(72);
    if panel.is_y_log {
        on_axes(builder, x, y.log_scale(), panel, labels, |value| format!("{value:.0e}"))
    } else {
        on_axes(builder, x, y, panel, labels, |value| number(*value))
    }
}

fn on_axes<B, Y>(
    mut builder: ChartBuilder<'_, '_, B>,
    x: Range<f64>,
    y: Y,
    panel: &Panel,
    labels: &[&str],
    format_y: impl Fn(&f64) -> String,
) -> Drawn<B>
where
    B: DrawingBackend,
    Y: AsRangedCoord<Value = f64>,
    Y::CoordDescType: ValueFormatter<f64>,
{
    let mut chart = builder.build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(FAINT.mix(0.5))
        .axis_style(FAINT)
        .x_labels(6)
        .y_labels(6)
        .x_desc(&panel.x_label)
        .y_desc(&panel.y_label)
        .x_label_formatter(&|value| number(*value))
        .y_label_formatter(&format_y)
        .label_style((FONT, 14).into_font().color(&INK))
        .draw()?;
    for series in &panel.series {
        let colour = colour(labels, &series.label);
        let line = |points: Vec<(f64, f64)>| PathElement::new(points, colour.stroke_width(2));
        if series.is_curve {
            let banded = series.points.iter().filter_map(|p| Some((p.x, p.y_interval?)));
            let low: Vec<(f64, f64)> = banded.clone().map(|(x, (low, _))| (x, low)).collect();
            let high = banded.map(|(x, (_, high))| (x, high)).rev();
            let band: Vec<(f64, f64)> = low.into_iter().chain(high).collect();
            chart.draw_series([Polygon::new(band, colour.mix(0.18).filled())])?;
            chart.draw_series([line(series.points.iter().map(|p| (p.x, p.y)).collect())])?;
            continue;
        }
        for point in &series.points {
            if let Some((low, high)) = point.x_interval {
                chart.draw_series([line(vec![(low, point.y), (high, point.y)])])?;
            }
            if let Some((low, high)) = point.y_interval {
                chart.draw_series([line(vec![(point.x, low), (point.x, high)])])?;
            }
            chart.draw_series([Circle::new((point.x, point.y), 6, colour.filled())])?;
        }
    }
    Ok(())
}

/// From a little below the least value to a little above the greatest.
fn span(values: impl Iterator<Item = f64>, is_log: bool) -> Range<f64> {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if is_log {
        return low / 1.5..high * 1.5;
    }
    let width = high - low;
    let margin = if width > 0.0 { 0.06 * width } else { 0.5 * low.abs().max(1.0) };
    low - margin..high + margin
}

/// Short, for an axis: 20000 is 20k.
fn number(value: f64) -> String {
    let size = value.abs();
    if size >= 1e6 {
        format!("{:.1}M", value / 1e6)
    } else if size >= 1e4 {
        format!("{:.0}k", value / 1e3)
    } else if size < 1e-12 {
        "0".to_owned()
    } else if size >= 100.0 || value.fract() == 0.0 {
        format!("{value:.0}")
    } else if size >= 0.095 {
        format!("{value:.1}")
    } else {
        format!("{value:.1e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(label: &str, points: Vec<Point>, is_curve: bool) -> Series {
        Series { label: label.into(), points, is_curve }
    }

    fn panel(is_y_log: bool, series: Vec<Series>) -> Panel {
        Panel {
            title: "leakage".into(),
            x_label: "steps".into(),
            y_label: "HSCIC".into(),
            is_y_log,
            series,
        }
    }

    #[test]
    fn both_files_are_drawn_and_show_what_they_were_given() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("figure");
        let banded = Point { y_interval: Some((0.5, 3.0)), ..Point::new(1.0, 2.0) };
        let curve = series("bc", vec![Point::new(0.0, 1.0), banded], true);
        let dots = series("expert", vec![banded, Point::new(2.0, 0.01)], false);
        let panels = [panel(false, vec![curve.clone()]), panel(true, vec![curve, dots])];
        figure(&path, "hopper-w2", &panels).unwrap();
        let svg = std::fs::read_to_string(path.with_extension("svg")).unwrap();
        for text in ["hopper-w2", "leakage", "steps", "HSCIC", "bc", "expert"] {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(svg.matches("<circle").count(), 2);
        assert!(std::fs::read(path.with_extension("png")).unwrap().starts_with(b"\x89PNG"));
    }

    #[test]
    fn what_has_no_place_is_left_out_and_nothing_at_all_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("figure");
        let odd = vec![
            Point::new(0.0, f64::NAN),
            Point::new(f64::INFINITY, 1.0),
            Point { y_interval: Some((f64::NAN, 1.0)), ..Point::new(1.0, 1.0) },
            Point { y_interval: Some((-1.0, 1.0)), ..Point::new(2.0, 1.0) },
            Point::new(3.0, -1.0),
        ];
        figure(&path, "", &[panel(true, vec![series("bc", odd.clone(), true)])]).unwrap();
        let empty = panel(false, vec![series("bc", odd[..2].to_vec(), true)]);
        let error = figure(&path, "", &[empty]).unwrap_err().to_string();
        assert!(error.contains("nothing in panel \"leakage\" is finite"), "{error}");
        assert!(figure(&path, "", &[]).is_err());
        let missing = folder.path().join("absent/figure");
        let one = panel(false, vec![series("bc", vec![Point::new(1.0, 1.0)], true)]);
        assert!(figure(&missing, "", &[one]).is_err());
    }
}
