//! Progress bars with an estimate of the time left; on stderr, and only on a terminal.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar that counts `total` of `unit`.
pub fn bar(label: &str, total: u64, unit: &str) -> ProgressBar {
    let template = format!(
        "{{prefix:>18}} {{bar:32.cyan/dim}} {{human_pos}}/{{human_len}} {unit} · {{per_sec}} · {{eta}} left {{msg}}"
    );
    let style = ProgressStyle::with_template(&template)
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .progress_chars("━╸─");
    let bar = ProgressBar::new(total).with_style(style).with_prefix(label.to_owned());
    bar.enable_steady_tick(std::time::Duration::from_millis(200));
    bar
}
