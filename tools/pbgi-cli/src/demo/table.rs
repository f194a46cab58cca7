//! The demo's one table.

use pbgi::figures::{format_bytes, format_count, format_seconds};
use pbgi::{BakeReport, ShadeReport};

/// Names of the bake's phases that gather light.
const LIGHT_PHASES: [&str; 2] = ["light", "bounce"];

/// What was made and how fast, as labels and values.
pub fn rows(baked: &BakeReport, shaded: &ShadeReport) -> Vec<(&'static str, String)> {
    let is_light = |name: &str| LIGHT_PHASES.contains(&name);
    let plain: f64 = baked.phases.iter().filter(|p| !is_light(p.name)).map(|p| p.seconds).sum();
    let rate = |count: u64, seconds: f64| format_count(count as f64 / seconds.max(1e-9));
    let limit = format_bytes(shaded.memory.limit_bytes);
    let peak = shaded.memory_peak_bytes.map_or("unknown".to_owned(), format_bytes);
    let mut rows = vec![
        ("surfels", format_count(baked.surfels as f64)),
        ("bake", format!("{} surfels/s, sorted and built", rate(baked.surfels, plain))),
        (
            "bake with light",
            format!(
                "{} surfels/s ({})",
                rate(baked.surfels, baked.seconds),
                format_seconds(baked.seconds)
            ),
        ),
        (
            "file",
            format!(
                "{}, {:.1} bytes per surfel",
                format_bytes(baked.file_bytes),
                baked.bytes_per_surfel.total()
            ),
        ),
        ("receivers", format_count(shaded.receivers as f64)),
        (
            "shade",
            format!(
                "{} receivers/s ({})",
                format_count(shaded.receivers_per_second.round()),
                format_seconds(shaded.shade_seconds)
            ),
        ),
        ("mean cut", format!("{} nodes and surfels", format_count(shaded.cut_mean.round()))),
        ("cache hit rate", format!("{:.3} %", shaded.cache.hit_rate * 100.0)),
        ("read amplification", format!("{:.2}", shaded.cache.read_amplification)),
        ("peak memory", format!("{peak} of {limit}")),
    ];
    if let Some(check) = &shaded.check {
        let error = |rrmse: f64, bias: f64, p99: f64| {
            let [rrmse, bias, p99] = [rrmse, bias, p99].map(|x| x * 100.0);
            format!("{rrmse:.2} % relative rmse, {bias:+.2} % bias, {p99:.1} % p99")
        };
        let receivers = check.receivers;
        let all = error(check.rrmse, check.bias, check.p99);
        rows.push(("error", format!("{all} ({receivers} receivers)")));
    }
    rows
}
