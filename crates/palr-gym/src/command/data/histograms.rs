//! Histograms of a data set.

use std::path::Path;

use palr_gym_data::statistics::{BINS, Statistics};
use palr_gym_trainer::plot::{Panel, Point, Series, figure};

/// Draws episode returns, episode lengths and every entry of the action, as `path`.svg and .png.
pub fn draw(path: &Path, file: &Path, statistics: &Statistics) -> anyhow::Result<()> {
    let lengths: Vec<f64> = statistics.lengths.iter().map(|&length| length as f64).collect();
    let entries = statistics.actions.iter().enumerate().map(|(index, action)| {
        outline_of(&format!("entry {index}"), &action.histogram, (-1.0, 1.0))
    });
    let panel = |title: &str, x_label: &str, y_label: &str, series| Panel {
        title: title.to_owned(),
        x_label: x_label.to_owned(),
        y_label: y_label.to_owned(),
        is_y_log: false,
        series,
    };
    let episodes = |values: &[f64]| vec![outline("episodes", values)];
    let panels = [
        panel("Episodes", "return", "share of episodes", episodes(&statistics.returns)),
        panel("Episodes", "length (steps)", "share of episodes", episodes(&lengths)),
        panel("Actions", "action", "share of transitions", entries.collect()),
    ];
    let title = file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into());
    Ok(figure(path, &title, &panels)?)
}

/// The outline of a histogram: the share of `values` in each of equally wide bins.
fn outline(label: &str, values: &[f64]) -> Series {
    let fold = |start: f64, pick: fn(f64, f64) -> f64| values.iter().copied().fold(start, pick);
    let (low, high) = (fold(f64::INFINITY, f64::min), fold(f64::NEG_INFINITY, f64::max));
    // Equal values stand in the middle of a bin of their own.
    let (low, high) = if high > low { (low, high) } else { (low - 0.5, low + 0.5) };
    let width = (high - low) / BINS as f64;
    let mut counts = [0; BINS];
    for value in values {
        counts[(((value - low) / width) as usize).min(BINS - 1)] += 1;
    }
    outline_of(label, &counts, (low, high))
}

/// The outline of a histogram of equally wide bins.
fn outline_of(label: &str, counts: &[u64; BINS], (low, high): (f64, f64)) -> Series {
    let total = counts.iter().sum::<u64>() as f64;
    let width = (high - low) / BINS as f64;
    let mut points = vec![Point::new(low, 0.0)];
    for (bin, &count) in counts.iter().enumerate() {
        let share = count as f64 / total;
        points.push(Point::new(low + width * bin as f64, share));
        points.push(Point::new(low + width * (bin + 1) as f64, share));
    }
    points.push(Point::new(high, 0.0));
    Series { label: label.to_owned(), points, is_curve: true }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outline_has_the_area_of_one_and_the_height_of_each_bin() {
        let values = [0.0, 0.01, 0.99, 1.0];
        let series = outline("", &values);
        assert_eq!(series.points.len(), 2 * BINS + 2);
        let heights: Vec<f64> =
            series.points[1..].chunks_exact(2).take(BINS).map(|pair| pair[0].y).collect();
        assert!((heights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert_eq!((heights[0], heights[BINS - 1]), (0.5, 0.5));
        let same = outline("", &[3.0; 5]);
        assert_eq!(same.points.iter().map(|point| point.y).fold(0.0, f64::max), 1.0);
    }
}
