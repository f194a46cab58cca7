//! Error and bytes of directional forms for the nodes of real clouds: spherical harmonics, flat clusters, lobes, ambient cubes, codebooks.
//!
//! `cargo run --release -p pbgi-benches --bin forms -- --data ../shared/data --json forms.json`

mod codebook;
mod cube;
mod errors;
mod harmonics;
mod lobes;
mod target;

use anyhow::{Context, Result};
use clap::Parser;
use codebook::Codebook;
use cube::CubeFit;
use errors::{NodeErrors, Spread, errors};
use harmonics::{Shapes, show_all, show_shapes};
use pbgi_benches::{lit_surfels, read_sorted};
use pbgi_build::{BuildOptions, NodeAggregate};
use pbgi_cloud::{SliceSource, Surfel};
use pbgi_format::LOBES_MAX;
use pbgi_math::MORTON_AXIS_BITS;
use pbgi_sort::{SortOptions, sort_surfels};
use serde::Serialize;
use std::ops::Range;
use std::path::PathBuf;
use target::{Shown, Sphere, Target};

/// Compares candidates for the directional form of a node.
#[derive(Parser)]
struct Arguments {
    /// Folder with sponza_crytek.glb, autzen_stadium.laz and an environment; scenes it lacks are left out.
    #[arg(long, default_value = "../shared/data")]
    data: PathBuf,
    /// Surfels per scene.
    #[arg(long, default_value_t = 500_000)]
    surfels: u64,
    /// Nodes of each size and scene that are looked at.
    #[arg(long, default_value_t = 1000)]
    nodes: usize,
    /// Print each size of nodes by itself, too.
    #[arg(long)]
    by_size: bool,
    /// Where to write the table as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Scenes: street, sponza, foliage, scan.
    #[arg(default_values_t = ["street", "sponza", "foliage", "scan"].map(str::to_owned))]
    scenes: Vec<String>,
}

/// Sizes of the nodes that cuts take, in surfels.
const SIZES: [Range<usize>; 3] = [8..32, 32..128, 128..513];

/// Nodes that codebooks learn from, at most.
const LEARNED_FROM: usize = 20_000;

/// Entries of the codebooks, and bytes of an index.
const CODEBOOKS: [(usize, f64); 2] = [(256, 1.0), (4096, 1.5)];

/// A node of the octree.
struct Node {
    surfels: Range<usize>,
    aggregate: NodeAggregate,
}

/// The octree's cells as the build makes them, except where more surfels than a leaf holds share one code.
struct Cells<'a> {
    codes: &'a [u64],
    surfels: &'a [Surfel],
    nodes: Vec<Node>,
}

impl Cells<'_> {
    /// Adds the node of a range of surfels whose codes agree above the lowest `bits`, after all below it.
    fn add(&mut self, range: Range<usize>, bits: u32) -> NodeAggregate {
        let leaf_max = BuildOptions::default().leaf_surfels_max;
        let aggregate = if range.len() <= leaf_max || bits == 0 {
            NodeAggregate::from_surfels(&self.surfels[range.clone()])
        } else {
            let octant = |code: u64| code >> (bits - 3) & 7;
            let mut children = Vec::new();
            let mut start = range.start;
            while start < range.end {
                let own = octant(self.codes[start]);
                let rest = &self.codes[start..range.end];
                let end = start + rest.partition_point(|code| octant(*code) <= own);
                children.push(self.add(start..end, bits - 3));
                start = end;
            }
            if let [_] = children[..] {
                // A single octant is handed up; it is among the nodes.
                return children.swap_remove(0);
            }
            NodeAggregate::from_children(children.iter())
        };
        if SIZES.iter().any(|size| size.contains(&range.len())) {
            self.nodes.push(Node { surfels: range, aggregate: aggregate.clone() });
        }
        aggregate
    }
}

/// What one form costs and shows of one node.
struct Outcome {
    bytes: f64,
    occlusion_bytes: f64,
    errors: NodeErrors,
}

/// What all forms are judged with.
struct Judge {
    sphere: Sphere,
    cube: CubeFit,
    codebooks: Vec<Codebook>,
}

impl Judge {
    fn names() -> Vec<String> {
        let lobes = (1..=LOBES_MAX).map(|most| match most {
            LOBES_MAX => format!("lobes, 1 to {LOBES_MAX}, as stored"),
            most => format!("lobes, at most {most}"),
        });
        let books = CODEBOOKS.map(|(size, _)| format!("codebook of {size} SH shapes"));
        ["flat cluster"]
            .map(str::to_owned)
            .into_iter()
            .chain(lobes)
            .chain(["SH, 16 bits", "SH, 8 bits", "SH, 8 bits, one color"].map(str::to_owned))
            .chain(["ambient cube, 8 bits", "ambient cube, one color"].map(str::to_owned))
            .chain(books)
            .collect()
    }

    /// The outcomes of all forms, in the order of their names.
    fn judge(&self, target: &Target) -> Vec<Outcome> {
        let outcome = |bytes: f64, occlusion_bytes: f64, shown: &Shown| Outcome {
            bytes,
            occlusion_bytes,
            errors: errors(shown, &target.exact),
        };
        let (sphere, sh) = (&self.sphere, &target.harmonics);
        // Normal, area, color.
        let mut all = vec![outcome(9.0, 5.0, &lobes::show_flat(target, sphere))];
        for most in 1..=LOBES_MAX {
            let (shown, count) = lobes::show_at_most(target, most, sphere);
            all.push(outcome(12.0 * count as f64, 8.0 * count as f64, &shown));
        }
        // Two bytes for the first coefficient of a function, one or two for each of eight others.
        all.push(outcome(4.0 * 18.0, 18.0, &show_all(sh, 16, sphere)));
        all.push(outcome(4.0 * 10.0, 10.0, &show_all(sh, 8, sphere)));
        let shapes = Shapes::of(sh);
        let one_color = show_shapes(sh, &shapes.rounded(8), sphere);
        all.push(outcome(10.0 + 8.0 + 4.0, 10.0, &one_color));
        // Two bytes for the largest side, one for each.
        all.push(outcome(4.0 * 8.0, 8.0, &self.cube.show_all(&target.exact)));
        all.push(outcome(8.0 + 6.0 + 4.0, 8.0, &self.cube.show_one_color(&target.exact)));
        for (book, (_, index)) in self.codebooks.iter().zip(CODEBOOKS) {
            let shown = show_shapes(sh, &book.look_up(&shapes), sphere);
            all.push(outcome(2.0 + 4.0 + index, 2.0 + index, &shown));
        }
        all
    }
}

/// A row of the table.
#[derive(Clone, Debug, Serialize)]
struct Row {
    scene: String,
    surfels: String,
    form: String,
    bytes: f64,
    occlusion_bytes: f64,
    area: Spread,
    flux: Spread,
    /// Of both, every piece of area alike.
    error: f64,
    /// Of both, every node alike.
    error_by_node: f64,
}

/// The row of a form, over nodes with their weights.
fn row(scene: &str, surfels: &str, form: &str, outcomes: &[(f64, Outcome)]) -> Row {
    let mean = |f: &dyn Fn(&Outcome) -> f64| {
        outcomes.iter().map(|(_, o)| f(o)).sum::<f64>() / outcomes.len().max(1) as f64
    };
    let area = Spread::of(outcomes.iter().map(|(w, o)| (*w, o.errors.area)).collect());
    let flux = outcomes.iter().filter_map(|(w, o)| Some((*w, o.errors.flux?)));
    let flux = Spread::of(flux.collect());
    Row {
        scene: scene.to_owned(),
        surfels: surfels.to_owned(),
        form: form.to_owned(),
        bytes: mean(&|o| o.bytes),
        occlusion_bytes: mean(&|o| o.occlusion_bytes),
        area,
        flux,
        error: (0.5 * (area.rrmse.powi(2) + flux.rrmse.powi(2))).sqrt(),
        error_by_node: mean(&|o| o.errors.combined().powi(2)).sqrt(),
    }
}

/// The nodes of a size: those to look at, evenly spread, and the others.
fn choose<'a>(nodes: &[&'a Node], most: usize) -> (Vec<&'a Node>, Vec<&'a Node>) {
    let step = nodes.len().div_ceil(most).max(1);
    let all = nodes.iter().copied().enumerate();
    let (chosen, others): (Vec<_>, Vec<_>) = all.partition(|(i, _)| i % step == 0);
    let strip = |list: Vec<(usize, &'a Node)>| list.into_iter().map(|(_, node)| node).collect();
    (strip(chosen), strip(others))
}

/// All rows of a scene, those of all sizes last.
fn measure(scene: &str, surfels: &[Surfel], arguments: &Arguments) -> Result<Vec<Row>> {
    let mut sorted = sort_surfels(&mut SliceSource::new(surfels), &SortOptions::default())?;
    let (codes, surfels) = read_sorted(&mut sorted)?;
    let mut cells = Cells { codes: &codes, surfels: &surfels, nodes: Vec::new() };
    cells.add(0..surfels.len(), 3 * MORTON_AXIS_BITS);
    let sphere = Sphere::new();
    let target =
        |node: &Node| Target::new(&surfels[node.surfels.clone()], &node.aggregate, &sphere);
    let mut chosen = Vec::new();
    let mut learned_from = Vec::new();
    for size in &SIZES {
        let own = |node: &&Node| size.contains(&node.surfels.len());
        let nodes: Vec<&Node> = cells.nodes.iter().filter(own).collect();
        let (some, others) = choose(&nodes, arguments.nodes);
        chosen.push(some);
        learned_from.extend(others);
    }
    let step = learned_from.len().div_ceil(LEARNED_FROM).max(1);
    let shapes: Vec<Shapes> = learned_from
        .iter()
        .step_by(step)
        .map(|node| Shapes::of(&target::harmonics_of(&surfels[node.surfels.clone()])))
        .collect();
    let codebooks = CODEBOOKS.map(|(size, _)| Codebook::learn(&shapes, size)).into();
    let judge = Judge { cube: CubeFit::new(&sphere), sphere: Sphere::new(), codebooks };
    let mut rows = Vec::new();
    // By form: outcomes with their weights, by which all sizes have the same share.
    let mut whole: Vec<Vec<(f64, Outcome)>> = Judge::names().iter().map(|_| Vec::new()).collect();
    for (size, nodes) in SIZES.iter().zip(&chosen) {
        let targets: Vec<Target> = nodes.iter().map(|node| target(node)).collect();
        let total: f64 = targets.iter().map(|t| t.area).sum();
        let first = whole[0].len();
        for target in &targets {
            for (list, outcome) in whole.iter_mut().zip(judge.judge(target)) {
                list.push((target.area / total, outcome));
            }
        }
        let label = format!("{} to {}", size.start, size.end - 1);
        rows.extend(rows_of(scene, &label, &whole, first));
    }
    rows.extend(rows_of(scene, "all", &whole, 0));
    Ok(rows)
}

/// One row for each form, over its outcomes from the one at `first` on.
fn rows_of(scene: &str, size: &str, all: &[Vec<(f64, Outcome)>], first: usize) -> Vec<Row> {
    let names = Judge::names();
    names.iter().zip(all).map(|(name, list)| row(scene, size, name, &list[first..])).collect()
}

fn print_rows(rows: &[Row]) {
    println!(
        "{:26} {:>6} {:>9} {:>8} {:>8} {:>8} {:>8} {:>8} {:>9} {:>8} {:>9}",
        "form",
        "bytes",
        "occlusion",
        "area",
        "p99",
        "flux",
        "p99",
        "both",
        "x bytes",
        "by node",
        "x bytes"
    );
    for r in rows {
        println!(
            "{:26} {:6.1} {:9.1} {:6.2} % {:6.1} % {:6.2} % {:6.1} % {:6.2} % {:9.2} {:6.2} % {:9.2}",
            r.form,
            r.bytes,
            r.occlusion_bytes,
            r.area.rrmse * 100.0,
            r.area.p99 * 100.0,
            r.flux.rrmse * 100.0,
            r.flux.p99 * 100.0,
            r.error * 100.0,
            r.error * r.bytes,
            r.error_by_node * 100.0,
            r.error_by_node * r.bytes,
        );
    }
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let mut all = Vec::new();
    for scene in &arguments.scenes {
        let surfels = lit_surfels(scene, arguments.surfels, &arguments.data)?;
        let Some(surfels) = surfels else {
            println!("{scene}: skipped, no data in {}", arguments.data.display());
            continue;
        };
        let rows = measure(scene, &surfels, &arguments).with_context(|| scene.clone())?;
        for rows in rows.chunk_by(|a, b| a.surfels == b.surfels) {
            if arguments.by_size || rows[0].surfels == "all" {
                println!("\n{scene}, nodes of {} surfels", rows[0].surfels);
                print_rows(rows);
            }
        }
        all.extend(rows);
    }
    if let Some(path) = &arguments.json {
        std::fs::write(path, serde_json::to_string_pretty(&all)?)?;
    }
    Ok(())
}
