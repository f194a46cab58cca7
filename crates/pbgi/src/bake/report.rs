//! What a bake did, for people and for programs.

use crate::figures::{format_bytes, format_count, format_seconds};
use pbgi_build::BuildReport;
use serde::Serialize;

/// What a bake did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct BakeReport {
    /// Inputs as named.
    pub inputs: Vec<String>,
    /// The octree file.
    pub output: String,
    /// Surfels in it.
    pub surfels: u64,
    /// Records dropped because they hold no valid surfel (`--skip-invalid`).
    pub skipped: u64,
    /// LAS points left out because of their class (`--classes`, `--skip-classes`).
    pub left_out_by_class: u64,
    /// LAS points left out because they are marked as withheld.
    pub left_out_withheld: u64,
    /// Nodes, leaves included.
    pub nodes: u64,
    /// Leaves.
    pub leaves: u64,
    /// Pages.
    pub pages: u64,
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Bytes per surfel by kind; their sum times the surfels is the file's size.
    pub bytes_per_surfel: BytesPerSurfel,
    /// Coarsest spacing meshes were diced with, in scene units; none without meshes.
    pub spacing: Option<f64>,
    /// Point and spot lights that became surfels.
    pub lights: u64,
    /// Estimated sizes, where the clouds had none.
    pub estimated_sizes: u64,
    /// Estimated normals, where the clouds had none.
    pub estimated_normals: u64,
    /// Sorted runs on disk; 0 where everything fit into memory.
    pub sorted_runs: u64,
    /// What was done, in order.
    pub phases: Vec<PhaseReport>,
    /// Seconds of wall time in all.
    pub seconds: f64,
    /// Surfels per second in all, from reading to the finished file.
    pub surfels_per_second: f64,
    /// Threads used.
    pub threads: usize,
    /// Seconds of CPU time in the program's own code, all threads together.
    pub user_seconds: f64,
    /// Seconds of CPU time in the system's code.
    pub system_seconds: f64,
    /// Bytes read: input and temporary files, from disk or from the system's cache.
    pub read_bytes: u64,
    /// Bytes written: temporary files and output.
    pub written_bytes: u64,
    /// The memory limit.
    pub memory_limit_bytes: u64,
    /// Most bytes the process held at once, where the system tells.
    pub memory_peak_bytes: Option<u64>,
    /// What the user should know, one sentence each.
    pub warnings: Vec<String>,
}

/// Bytes of the file per surfel, by what they hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct BytesPerSurfel {
    /// Stored surfels.
    pub surfels: f64,
    /// What every walk reads of the nodes: boxes and links.
    pub nodes_hot: f64,
    /// Directional area and intensity of the nodes.
    pub nodes_directional: f64,
    /// Page headers, alignment, page table; negative where compression saves more.
    pub pages: f64,
}

impl BytesPerSurfel {
    /// Everything.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.surfels + self.nodes_hot + self.nodes_directional + self.pages
    }

    pub(crate) fn new(report: &BuildReport) -> Self {
        let per_surfel = |bytes: f64| bytes / report.surfels.max(1) as f64;
        Self {
            surfels: per_surfel(report.surfel_bytes as f64),
            nodes_hot: per_surfel(report.node_hot_bytes as f64),
            nodes_directional: per_surfel(report.lobe_bytes as f64),
            pages: per_surfel(report.overhead_bytes as f64),
        }
    }
}

/// One phase of a bake.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PhaseReport {
    /// Its name.
    pub name: &'static str,
    /// Of a pass of light, which bounce it is, from 1; 0 is the environment's.
    pub bounce: Option<u32>,
    /// Seconds of wall time.
    pub seconds: f64,
    /// Surfels per second.
    pub surfels_per_second: f64,
    /// Gathers of a pass of light: as many as surfels, or fewer where neighbors share them (`--bounce-share`).
    pub gathers: Option<u64>,
}

impl PhaseReport {
    pub(crate) fn new(name: &'static str, seconds: f64, surfels: u64) -> Self {
        let surfels_per_second = surfels as f64 / seconds.max(1e-9);
        Self { name, bounce: None, seconds, surfels_per_second, gathers: None }
    }

    /// The same, of a pass of light.
    pub(crate) fn of_light(self, bounce: u32, gathers: u64) -> Self {
        Self { bounce: Some(bounce), gathers: Some(gathers), ..self }
    }

    /// Time and rate, behind the number of the bounce if there may be several.
    fn text(&self) -> String {
        let (seconds, rate) = (format_seconds(self.seconds), format_count(self.surfels_per_second));
        let gathers = self.gathers.map_or(String::new(), |gathers| {
            let per_second = gathers as f64 / self.seconds.max(1e-9);
            format!(", {} gathers/s", format_count(per_second))
        });
        let number = self.bounce.filter(|&b| b > 0).map_or(String::new(), |b| format!("{b}: "));
        format!("{number}{seconds}, {rate} surfels/s{gathers}")
    }
}

impl BakeReport {
    /// Labels and values, for [`crate::figures::format_table`].
    #[must_use]
    pub fn rows(&self) -> Vec<(&'static str, String)> {
        let rate = |r: f64| format!("{} surfels/s", format_count(r));
        let bytes = &self.bytes_per_surfel;
        let mut rows = vec![
            ("output", self.output.clone()),
            ("surfels", format!("{}", self.surfels)),
            ("nodes", format!("{} ({} leaves, {} pages)", self.nodes, self.leaves, self.pages)),
            ("file", format_bytes(self.file_bytes)),
            (
                "bytes/surfel",
                format!(
                    "{:.2} = surfels {:.2} + nodes {:.2} + directional {:.2} + pages {:.2}",
                    bytes.total(),
                    bytes.surfels,
                    bytes.nodes_hot,
                    bytes.nodes_directional,
                    bytes.pages
                ),
            ),
        ];
        if let Some(spacing) = self.spacing {
            rows.push(("spacing", format!("{spacing:.6} (--spacing or --surfels set it)")));
        }
        if self.lights > 0 {
            rows.push(("lights", format!("{} (--light-scale scales them)", self.lights)));
        }
        if self.skipped > 0 {
            rows.push(("skipped", format!("{} invalid records", self.skipped)));
        }
        let (by_class, withheld) = (self.left_out_by_class, self.left_out_withheld);
        if by_class + withheld > 0 {
            let text = format!("{by_class} points by class (--classes), {withheld} withheld");
            rows.push(("left out", text));
        }
        if self.estimated_sizes + self.estimated_normals > 0 {
            let (sizes, normals) = (self.estimated_sizes, self.estimated_normals);
            rows.push(("estimated", format!("{sizes} sizes, {normals} normals")));
        }
        for phase in &self.phases {
            rows.push((phase.name, phase.text()));
        }
        let total = format_seconds(self.seconds);
        rows.push(("total", format!("{total}, {}", rate(self.surfels_per_second))));
        if let Some(peak) = self.memory_peak_bytes {
            let limit = self.memory_limit_bytes;
            let share = peak as f64 / limit.max(1) as f64 * 100.0;
            let (peak, limit) = (format_bytes(peak), format_bytes(limit));
            rows.push(("peak memory", format!("{peak} of {limit} ({share:.0} %)")));
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_of_bytes_add_up_to_the_file() {
        let build = BuildReport {
            surfels: 100,
            nodes: 20,
            leaves: 10,
            pages: 2,
            file_bytes: 2300,
            surfel_bytes: 1400,
            node_hot_bytes: 500,
            lobe_bytes: 300,
            overhead_bytes: 100,
            dim_surfels: 0,
        };
        assert!((BytesPerSurfel::new(&build).total() - 23.0).abs() < 1e-9);
    }

    #[test]
    fn every_bounce_has_its_row() {
        let light = PhaseReport::new("light", 2.0, 1000).of_light(0, 1000);
        let bounces = (1..3).map(|b| PhaseReport::new("bounce", 0.5, 1000).of_light(b, 100));
        let phases = std::iter::once(light).chain(bounces).collect();
        let rows = BakeReport { phases, ..BakeReport::default() }.rows();
        let of =
            |name| rows.iter().filter(|r| r.0 == name).map(|r| r.1.as_str()).collect::<Vec<_>>();
        assert!(of("light")[0].ends_with("500 surfels/s, 500 gathers/s"), "{rows:?}");
        let [first, second] = of("bounce")[..] else { panic!("{rows:?}") };
        assert!(first.starts_with("1: ") && second.starts_with("2: "), "{rows:?}");
        assert!(second.ends_with("200 gathers/s"), "{rows:?}");
    }

    #[test]
    fn rows_leave_out_what_did_not_happen() {
        let labels = |report: &BakeReport| report.rows().iter().map(|r| r.0).collect::<Vec<_>>();
        let plain = labels(&BakeReport::default());
        assert!(!plain.contains(&"spacing") && !plain.contains(&"skipped"));
        assert!(!plain.contains(&"left out"));
        let scan = BakeReport { left_out_withheld: 1, ..BakeReport::default() };
        assert!(labels(&scan).contains(&"left out"));
        let full = BakeReport { spacing: Some(0.1), skipped: 3, ..BakeReport::default() };
        assert!(labels(&full).contains(&"spacing") && labels(&full).contains(&"skipped"));
    }
}
