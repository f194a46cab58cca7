//! Plots of shares against something else, both logarithmic.

use std::fmt::Write as _;

/// A curve of one of several plots.
#[derive(Clone, Debug)]
pub struct Line {
    /// Name of the plot it belongs to; lines of a plot follow each other.
    pub plot: String,
    /// What it shows.
    pub label: String,
    /// Something and a share, such as microseconds and a relative error; both above 0.
    pub points: Vec<(f64, f64)>,
}

const WIDTH: f64 = 420.0;
const HEIGHT: f64 = 300.0;
const MARGIN: f64 = 48.0;
/// Dark enough on white, and apart for most eyes.
const COLORS: [&str; 7] =
    ["#777777", "#d55e00", "#0072b2", "#009e73", "#cc79a7", "#b8860b", "#000000"];

/// An SVG document with a plot for each name, two in a row; `axes` says what is drawn against what.
#[must_use]
pub fn plot(lines: &[Line], axes: &str) -> String {
    let mut names: Vec<&str> = lines.iter().map(|l| l.plot.as_str()).collect();
    names.dedup();
    let rows = names.len().div_ceil(2) as f64;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{}\" height=\"{}\" font-family=\"sans-serif\" font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        2.0 * WIDTH,
        rows * HEIGHT
    );
    for (index, name) in names.iter().enumerate() {
        let (x, y) = ((index % 2) as f64 * WIDTH, (index / 2) as f64 * HEIGHT);
        let of_plot: Vec<&Line> = lines.iter().filter(|l| l.plot == *name).collect();
        let _ = writeln!(out, "<g transform=\"translate({x},{y})\">");
        draw_plot(&mut out, &format!("{name}: {axes}"), &of_plot);
        out.push_str("</g>\n");
    }
    out.push_str("</svg>\n");
    out
}

fn draw_plot(out: &mut String, title: &str, lines: &[&Line]) {
    let all = || lines.iter().flat_map(|l| &l.points);
    let range = |of: fn(&(f64, f64)) -> f64| {
        let (low, high) =
            all().map(of).fold((f64::INFINITY, 0f64), |r, x| (r.0.min(x), r.1.max(x)));
        (low.log10().floor(), high.log10().ceil())
    };
    let ((x0, x1), (y0, y1)) = (range(|p| p.0), range(|p| p.1));
    let (inner_x, inner_y) = (WIDTH - 2.2 * MARGIN, HEIGHT - 2.0 * MARGIN);
    let px = |x: f64| MARGIN + (x.log10() - x0) / (x1 - x0).max(1e-9) * inner_x;
    let py = |y: f64| MARGIN + (y1 - y.log10()) / (y1 - y0).max(1e-9) * inner_y;
    let _ = writeln!(out, "<text x=\"{MARGIN}\" y=\"24\" font-size=\"14\">{title}</text>");
    for decade in x0 as i32..=x1 as i32 {
        let (value, bottom) = (10f64.powi(decade), HEIGHT - MARGIN);
        let x = px(value);
        let _ = writeln!(
            out,
            "<path d=\"M{x:.1} {MARGIN}V{bottom}\" stroke=\"#dddddd\"/><text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\">{value}</text>",
            bottom + 14.0
        );
    }
    for decade in y0 as i32..=y1 as i32 {
        let value = 10f64.powi(decade);
        let y = py(value);
        let _ = writeln!(
            out,
            "<path d=\"M{MARGIN} {y:.1}h{inner_x}\" stroke=\"#dddddd\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{} %</text>",
            MARGIN - 4.0,
            y + 4.0,
            value * 100.0
        );
    }
    for (index, line) in lines.iter().enumerate() {
        let color = COLORS[index % COLORS.len()];
        let path: Vec<String> =
            line.points.iter().map(|p| format!("{:.1},{:.1}", px(p.0), py(p.1))).collect();
        let _ = writeln!(
            out,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.5\"/>",
            path.join(" ")
        );
        let label = if line.label.contains(',') { "all" } else { &line.label };
        let _ = writeln!(
            out,
            "<text x=\"{}\" y=\"{}\" fill=\"{color}\">{label}</text>",
            WIDTH - MARGIN - 8.0,
            MARGIN + 14.0 * (index + 1) as f64
        );
    }
}
