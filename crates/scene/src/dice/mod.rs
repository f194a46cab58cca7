//! Dicing: from meshes to micropolygons, one surfel (or two back to back) each.

mod lattice;
mod spacing;
mod surface;
mod triangle;

use crate::{Instance, Mesh, Scene, Texture};
use pbgi_cloud::{CloudError, Surfel, SurfelSource};
use pbgi_math::{Aabb, DVec3};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use triangle::{DicedPatch, InstanceView, Patch, RUN_CELLS, Work};

/// Surfels appended by one call of [`SurfelSource::read_chunk`], give or take those of one cell.
const CHUNK_SURFELS: usize = 4096;

/// Triangles of one task when counting; no two triangles of different runs are diced as one.
const RUN_TRIANGLES: usize = 1024;

/// Rows that are skipped as one where all their cells are holes.
const ROWS_SKIPPED: u64 = 64;

/// Micropolygons looked at by one call of [`SurfelSource::read_chunk`], about, where nearly all are holes.
const CHUNK_CELLS: u64 = 1 << 18;

/// Micropolygons of masked surfaces looked at to count surfels at one spacing, at most, and those for each surfel asked for. What is
/// seen to be a hole as a whole counts as a quarter of one. Where so little is left between holes that more are needed, the spacing stays coarser.
const COUNTED_CELLS_MAX: u64 = 1 << 18;
const COUNTED_CELLS_PER_SURFEL: u64 = 128;

/// How fine to dice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Spacing {
    /// Longest micropolygon edge, in scene units, above 0. Triangles smaller than that are their own
    /// micropolygon.
    Length(f32),
    /// As many surfels as this, within 2 % where the scene allows: there is at least one surfel per
    /// triangle (two if it has two sides), and a quarter more to cut the largest where their sizes differ; and the counts of a few large triangles
    /// come in steps.
    Count(u64),
}

/// Which surfaces get a surfel for each side.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TwoSided {
    /// Those whose material is double-sided.
    #[default]
    Material,
    /// All. A single-sided material still emits from its front only.
    All,
    /// None: one surfel, lit on its front and black at its back.
    None,
}

/// How to dice a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiceOptions {
    /// How fine.
    pub spacing: Spacing,
    /// Which surfaces get two surfels back to back, each with [`pbgi_cloud::SurfelFlags::FRONT_ONLY`].
    pub two_sided: TwoSided,
}

/// Why a scene cannot be diced.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DiceError {
    /// The spacing is no length.
    #[error("the spacing is {found}, but must be a length above 0")]
    Spacing {
        /// The spacing given.
        found: f32,
    },
    /// An index of the scene points to nothing.
    #[error("{place} refers to {what} {found}, but there are only {count}")]
    Index {
        /// Where the index is.
        place: String,
        /// What it should point to.
        what: &'static str,
        /// The index.
        found: u32,
        /// Number of things it may point to.
        count: usize,
    },
    /// The flag that may stop it was set.
    #[error("interrupted")]
    Stopped,
}

/// The micropolygons of a scene as a stream of surfels, in the order of instances, triangles, rows
/// of the triangle's lattice, columns; nothing is stored but the place in that order.
///
/// A triangle whose longest edge is at most the spacing is one micropolygon. A larger one is split by the height on that edge into two right
/// triangles, and these into strips across their longer leg, of at most the spacing, narrower where cells would be long and narrow: rectangles, and one
/// small right triangle on the third edge each. Two triangles that follow each other and make up a rectangle, also in what textures and colors
/// show, are cut as one. A micropolygon's surfel lies at its centroid, stands for exactly its rectangle or triangle
/// ([`Surfel::with_tile`], [`Surfel::with_triangle`]), and has the triangle's geometric normal, its filtered albedo, and its emission as radiance: the
/// outlines of all surfels cover each triangle without holes and without overlap. Where a
/// mask cuts holes, micropolygons near as large as the spacing are quartered, up to twice; of what is partly hole then, the area is scaled by the opaque share, the radius by
/// its root, and what is all hole is left out.
///
/// Triangles without area are skipped and counted; surfaces that are all hole are skipped unseen.
pub struct DicedScene<'a> {
    meshes: Meshes<'a>,
    spacing: f64,
    count: u64,
    totals: Totals,
    bounds: Aabb,
    cursor: Cursor<'a>,
}

/// What is diced.
struct Meshes<'a> {
    scene: &'a Scene,
    two_sided: TwoSided,
    /// Of each mesh, whether all of it is hole.
    holes: Vec<bool>,
    stop: &'a AtomicBool,
}

/// What never stops.
static NEVER: AtomicBool = AtomicBool::new(false);

/// The place in the stream.
#[derive(Default)]
struct Cursor<'a> {
    instance: usize,
    view: Option<InstanceView<'a>>,
    next_triangle: usize,
    patch: Option<DicedPatch<'a>>,
    piece: usize,
    row: u64,
    column: u64,
}

/// Sums over the triangles of a scene.
#[derive(Clone, Copy, Default)]
struct Totals {
    area: f64,
    visible_area: f64,
    /// In squares of the spacing times its square: two-sided surfaces count twice, coarse ones less.
    weighted_area: f64,
    degenerate_count: u64,
}

impl<'a> DicedScene<'a> {
    /// Prepares to dice `scene`. Counts the surfels, for [`Spacing::Count`] at up to eight spacings:
    /// a fast closed form per triangle, but masked materials are sampled. Uses the threads of the
    /// current rayon pool; the result does not depend on their number.
    ///
    /// # Errors
    ///
    /// If the spacing is not above 0, or an index in the scene points to nothing.
    pub fn new(scene: &'a Scene, options: DiceOptions) -> Result<Self, DiceError> {
        Self::new_until(scene, options, &NEVER)
    }

    /// As [`DicedScene::new`], which ends soon after `stop` is set.
    ///
    /// # Errors
    ///
    /// Those of [`DicedScene::new`], and [`DiceError::Stopped`].
    pub fn new_until(
        scene: &'a Scene,
        options: DiceOptions,
        stop: &'a AtomicBool,
    ) -> Result<Self, DiceError> {
        validate(scene)?;
        let holes = find_holes(scene);
        let meshes = Meshes { scene, two_sided: options.two_sided, holes, stop };
        let totals = meshes.sum_triangles();
        let found = match options.spacing {
            Spacing::Length(length) if length > 0.0 => {
                let spacing = f64::from(length);
                let count = meshes.count_surfels(spacing, u64::MAX).unwrap_or(0);
                spacing::Evaluation { spacing, count }
            }
            Spacing::Length(found) => return Err(DiceError::Spacing { found }),
            Spacing::Count(target) => {
                let cells_max = COUNTED_CELLS_PER_SURFEL.saturating_mul(target);
                let cells_max = cells_max.max(COUNTED_CELLS_MAX);
                spacing::find_spacing(target, totals.weighted_area, |h| {
                    meshes.count_surfels(h, cells_max)
                })
            }
        };
        if stop.load(Ordering::Relaxed) {
            return Err(DiceError::Stopped);
        }
        Ok(Self {
            meshes,
            spacing: found.spacing,
            count: found.count,
            totals,
            bounds: scene.bounds(),
            cursor: Cursor::default(),
        })
    }

    /// Longest micropolygon edge in scene units; infinite if [`Spacing::Count`] asked for fewer
    /// surfels than there are triangles, all of about one size.
    #[must_use]
    pub fn spacing(&self) -> f64 {
        self.spacing
    }

    /// Area of all triangles in scene units squared: one side, holes included.
    #[must_use]
    pub fn area(&self) -> f64 {
        self.totals.area
    }

    /// Area that gives surfels, in scene units squared: as [`DicedScene::area`], without what is all hole.
    #[must_use]
    pub fn visible_area(&self) -> f64 {
        self.totals.visible_area
    }

    /// Triangles without area, which give no surfel.
    #[must_use]
    pub fn degenerate_count(&self) -> u64 {
        self.totals.degenerate_count
    }

    /// Names of the materials whose surfaces are all hole and give no surfel, in the order of the scene.
    #[must_use]
    pub fn hole_materials(&self) -> Vec<&'a str> {
        let scene = self.meshes.scene;
        let mut is_named = vec![false; scene.materials.len()];
        for instance in &scene.instances {
            let material = scene.meshes[instance.mesh as usize].material as usize;
            is_named[material] |= self.meshes.holes[instance.mesh as usize];
        }
        let named = scene.materials.iter().zip(is_named).filter(|(_, is_named)| *is_named);
        named.map(|(material, _)| material.name.as_str()).collect()
    }

    /// Starts the stream again.
    pub fn rewind(&mut self) {
        self.cursor = Cursor::default();
    }
}

impl SurfelSource for DicedScene<'_> {
    fn origin(&self) -> DVec3 {
        self.meshes.scene.origin
    }

    /// Box of all meshes, which holds all centers.
    fn bounds(&self) -> Option<Aabb> {
        (!self.bounds.is_empty()).then_some(self.bounds)
    }

    fn count(&self) -> Option<u64> {
        Some(self.count)
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        let end = out.len() + CHUNK_SURFELS;
        let mut cells = 0;
        while out.len() < end && cells < CHUNK_CELLS {
            if !self.cursor.find_patch(&self.meshes, self.spacing) {
                return Ok(false);
            }
            cells += self.cursor.read_row(end, CHUNK_CELLS, out);
        }
        Ok(true)
    }
}

impl<'a> Cursor<'a> {
    /// Moves on to the next patch if none is being read; `false` at the end of the scene.
    fn find_patch(&mut self, meshes: &Meshes<'a>, spacing: f64) -> bool {
        while self.patch.is_none() {
            let Some(instance) = meshes.scene.instances.get(self.instance) else { return false };
            let view = *self.view.get_or_insert_with(|| meshes.view(instance));
            let is_hole = meshes.holes[instance.mesh as usize];
            if is_hole || self.next_triangle == view.mesh.triangles.len() {
                *self = Self { instance: self.instance + 1, ..Self::default() };
                continue;
            }
            let patch = view.patch(self.next_triangle);
            self.next_triangle += patch.map_or(1, |p| p.triangle_count());
            self.patch = patch.map(|p| view.dice(&p, spacing));
        }
        true
    }

    /// Appends surfels of the current row until it, the room up to `end`, or the number of cells is used up. Returns how many
    /// cells were looked at.
    fn read_row(&mut self, end: usize, cells_max: u64, out: &mut Vec<Surfel>) -> u64 {
        let Some(patch) = &mut self.patch else { return 0 };
        let lattice = patch.lattices.pieces[self.piece];
        let mut read = 1;
        if self.column == 0 && self.row.is_multiple_of(ROWS_SKIPPED) {
            let rows = self.row..lattice.row_count().min(self.row + ROWS_SKIPPED);
            if patch.are_holes(self.piece, rows.clone()) {
                (self.row, self.column) = (rows.end - 1, lattice.column_count(rows.end - 1));
            }
        }
        let columns = lattice.column_count(self.row);
        while self.column < columns && out.len() < end && read < cells_max {
            read += 1;
            if self.column.is_multiple_of(RUN_CELLS) {
                let run_end = columns.min(self.column + RUN_CELLS);
                if patch.is_hole_run(self.piece, self.row, self.column..run_end) {
                    self.column = run_end;
                    continue;
                }
            }
            patch.push_surfels(self.piece, &lattice.cell(self.column, self.row), out);
            self.column += 1;
        }
        if self.column == columns {
            (self.row, self.column) = (self.row + 1, 0);
        }
        if self.row == lattice.row_count() {
            (self.piece, self.row) = (self.piece + 1, 0);
        }
        if self.piece == patch.lattices.piece_count {
            (self.patch, self.piece) = (None, 0);
        }
        read
    }
}

impl<'a> Meshes<'a> {
    fn view(&self, instance: &Instance) -> InstanceView<'a> {
        InstanceView::new(self.scene, instance, self.two_sided)
    }

    /// Maps runs of triangles of each instance in parallel; results in the order of the scene.
    fn map_runs<T: Send>(&self, map: impl Fn(&InstanceView, Range<usize>) -> T + Sync) -> Vec<T> {
        let runs: Vec<(InstanceView, Range<usize>)> = self
            .scene
            .instances
            .iter()
            .map(|instance| self.view(instance))
            .flat_map(|view| {
                let count = view.mesh.triangles.len();
                let starts = (0..count).step_by(RUN_TRIANGLES);
                starts.map(move |start| (view, start..count.min(start + RUN_TRIANGLES)))
            })
            .collect();
        runs.into_par_iter().map(|(view, run)| map(&view, run)).collect()
    }

    fn sum_triangles(&self) -> Totals {
        let runs = self.map_runs(|view, run| {
            let mut totals = Totals::default();
            for index in run {
                match view.triangle(index) {
                    Some(triangle) => totals.area += triangle.area,
                    None => totals.degenerate_count += 1,
                }
            }
            if self.is_hole(view) {
                return totals;
            }
            let (visible_area, density) = (totals.area, view.surfel_density());
            Totals { visible_area, weighted_area: totals.area * density, ..totals }
        });
        // In order: the sum is the same for any number of threads.
        runs.iter().fold(Totals::default(), |sum, run| Totals {
            area: sum.area + run.area,
            visible_area: sum.visible_area + run.visible_area,
            weighted_area: sum.weighted_area + run.weighted_area,
            degenerate_count: sum.degenerate_count + run.degenerate_count,
        })
    }

    /// Surfels at a spacing; `None` if more than `cells_max` micropolygons of masked surfaces must be looked at.
    fn count_surfels(&self, spacing: f64, cells_max: u64) -> Option<u64> {
        let work = Work::new(self.stop, cells_max);
        let runs = self.map_runs(|view, run| {
            if self.is_hole(view) {
                return 0;
            }
            let (mut index, mut count) = (run.start, 0u64);
            while index < run.end && !work.is_over() {
                let patch = view.patch(index);
                index += patch.as_ref().map_or(1, Patch::triangle_count);
                let surfels = patch.map_or(0, |p| view.count_surfels(&p, spacing, &work));
                count = count.saturating_add(surfels);
            }
            count
        });
        (!work.is_too_much()).then(|| runs.into_iter().fold(0, u64::saturating_add))
    }

    fn is_hole(&self, view: &InstanceView) -> bool {
        self.holes[view.mesh_index as usize]
    }
}

/// Of each mesh, whether all of it is hole.
fn find_holes(scene: &Scene) -> Vec<bool> {
    // Textures are searched once each.
    let texel_max: Vec<f32> = (scene.materials.par_iter())
        .map(|material| {
            let masked = material.alpha_cutoff.and(material.base_color_texture);
            let texture = masked.and_then(|texture| scene.textures.get(texture as usize));
            texture.map_or(1.0, Texture::alpha_max)
        })
        .collect();
    let is_hole = |mesh: &Mesh| {
        let material = mesh.material as usize;
        let Some(cutoff) = scene.materials[material].alpha_cutoff else { return false };
        let vertex_max = mesh.alphas.iter().copied().reduce(f32::max).unwrap_or(1.0);
        let texel_max = if mesh.uvs.is_empty() { 1.0 } else { texel_max[material] };
        texel_max * vertex_max < cutoff
    };
    scene.meshes.iter().map(is_hole).collect()
}

/// Checks every index that dicing follows.
fn validate(scene: &Scene) -> Result<(), DiceError> {
    let check = |place: &dyn Fn() -> String, what, found: u32, count: usize| {
        let error = || DiceError::Index { place: place(), what, found, count };
        if (found as usize) < count { Ok(()) } else { Err(error()) }
    };
    for (i, instance) in scene.instances.iter().enumerate() {
        check(&|| format!("instance {i}"), "mesh", instance.mesh, scene.meshes.len())?;
    }
    for (i, mesh) in scene.meshes.iter().enumerate() {
        let place = || format!("mesh {i}");
        check(&place, "material", mesh.material, scene.materials.len())?;
        let largest = mesh.triangles.iter().flatten().max();
        largest.map_or(Ok(()), |&v| check(&place, "vertex", v, mesh.positions.len()))?;
    }
    for (i, material) in scene.materials.iter().enumerate() {
        if !(material.spacing_factor > 0.0 && material.spacing_factor.is_finite()) {
            return Err(DiceError::Spacing { found: material.spacing_factor });
        }
        for texture in [material.base_color_texture, material.emission_texture] {
            let place = || format!("material {i} ({})", material.name);
            texture.map_or(Ok(()), |t| check(&place, "texture", t, scene.textures.len()))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Material;
    use pbgi_cloud::SurfelFlags;
    use pbgi_math::{Affine3A, Mat3, Vec2, Vec3};

    /// One instance of one mesh.
    fn scene_of(mesh: Mesh, material: Material) -> Scene {
        Scene {
            meshes: vec![mesh],
            instances: vec![Instance { mesh: 0, transform: Affine3A::IDENTITY }],
            materials: vec![material],
            ..Scene::default()
        }
    }

    /// The square 0..1 × 0..1 at z = 0, facing +z, texture coordinates along x and y.
    fn square() -> Mesh {
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(Vec2::from_array);
        Mesh {
            positions: corners.iter().map(|c| c.extend(0.0)).collect(),
            uvs: corners.to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    /// Sphere of `rings` × 2 `rings` quads, some degenerate at the poles.
    fn sphere(rings: u32) -> Mesh {
        let columns = 2 * rings;
        let vertex = |i: u32| {
            let theta = (i / (columns + 1)) as f32 / rings as f32 * std::f32::consts::PI;
            let phi = (i % (columns + 1)) as f32 / columns as f32 * std::f32::consts::TAU;
            // Exactly at the poles, where the triangles then have no area.
            let sin = if i / (columns + 1) == rings { 0.0 } else { theta.sin() };
            Vec3::new(sin * phi.cos(), sin * phi.sin(), theta.cos())
        };
        let quad = |i: u32| {
            let v = i / columns * (columns + 1) + i % columns;
            [[v, v + columns + 1, v + 1], [v + 1, v + columns + 1, v + columns + 2]]
        };
        Mesh {
            positions: (0..(rings + 1) * (columns + 1)).map(vertex).collect(),
            triangles: (0..rings * columns).flat_map(quad).collect(),
            ..Mesh::default()
        }
    }

    fn dice(scene: &Scene, spacing: Spacing, two_sided: TwoSided) -> Vec<Surfel> {
        let mut diced = DicedScene::new(scene, DiceOptions { spacing, two_sided }).unwrap();
        let surfels = read_all(&mut diced);
        assert_eq!(diced.count(), Some(surfels.len() as u64));
        let bounds = diced.bounds().unwrap();
        assert!(surfels.iter().all(|s| bounds.contains(s.center())));
        surfels
    }

    fn read_all(diced: &mut DicedScene) -> Vec<Surfel> {
        let mut surfels = vec![];
        loop {
            let before = surfels.len();
            let more = diced.read_chunk(&mut surfels).unwrap();
            assert!(surfels.len() - before < CHUNK_SURFELS + triangle::CELL_SURFELS_MAX);
            if !more {
                return surfels;
            }
        }
    }

    fn area_of(surfels: &[Surfel]) -> f64 {
        surfels.iter().map(|s| f64::from(s.area)).sum()
    }

    #[test]
    fn surfel_areas_sum_to_the_area_of_the_mesh() {
        for rings in [3, 8, 40] {
            let scene = scene_of(sphere(rings), Material::default());
            for spacing in [0.013, 0.1, 10.0] {
                let options =
                    DiceOptions { spacing: Spacing::Length(spacing), two_sided: TwoSided::None };
                let mut diced = DicedScene::new(&scene, options).unwrap();
                let surfels = read_all(&mut diced);
                assert!((area_of(&surfels) / diced.area() - 1.0).abs() < 1e-6);
                assert_eq!(diced.degenerate_count(), u64::from(4 * rings));
                assert!(surfels.iter().all(|s| s.normal().dot(s.center()) > 0.0));
            }
        }
        let square = scene_of(square(), Material::default());
        assert!(
            (area_of(&dice(&square, Spacing::Length(0.03), TwoSided::None)) - 1.0).abs() < 1e-6
        );
    }

    #[test]
    fn slivers_have_a_finite_size() {
        let [near, thin, far] = [0x0909_0000, 0x0909_0909, 0x3f80_000b].map(f32::from_bits);
        let ends = [Vec3::new(0.0, 0.0, near), Vec3::splat(thin), Vec3::new(thin, far, 0.0)];
        let positions = ends.to_vec();
        let mesh = Mesh { positions, triangles: vec![[0, 1, 2]], ..Mesh::default() };
        for spacing in [Spacing::Length(1e-3), Spacing::Count(64), Spacing::Count(1000)] {
            let scene = scene_of(mesh.clone(), Material::default());
            let surfels = dice(&scene, spacing, TwoSided::None);
            assert!(!surfels.is_empty());
            let is_sized = |s: &Surfel| s.radius > 0.0 && s.radius.is_finite() && s.area > 0.0;
            assert!(surfels.iter().all(is_sized), "{:?}", surfels.iter().find(|s| !is_sized(s)));
        }
    }

    #[test]
    fn outlines_are_those_of_the_cells() {
        let mut mesh = square();
        mesh.triangles.truncate(1);
        // Stretched, sheared and turned.
        mesh.positions.iter_mut().for_each(|p| *p = Vec3::new(p.x + 0.4 * p.y, 0.3 * p.y, p.x));
        let corners = mesh.triangles[0].map(|i| mesh.positions[i as usize]);
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        let cloth = Material { double_sided: true, ..Material::default() };
        for spacing in [0.05, 0.3, 10.0] {
            let scene = scene_of(mesh.clone(), cloth.clone());
            let surfels = dice(&scene, Spacing::Length(spacing), TwoSided::Material);
            let mut kinds = [0, 0];
            for (i, surfel) in surfels.iter().enumerate() {
                assert!((surfel.normal().dot(normal).abs() - 1.0).abs() < 1e-6);
                let outline = match (surfel.half_edges(), surfel.corners()) {
                    (Some([a, b]), None) => vec![a + b, a - b, -a - b, b - a],
                    (None, Some(corners)) => corners.to_vec(),
                    other => panic!("{other:?}"),
                };
                kinds[usize::from(outline.len() == 3)] += 1;
                // Within the triangle, as well as codes of directions can tell: 0.76°.
                for corner in outline {
                    let place = surfel.center() + corner;
                    let inside = (0..3).map(|k| {
                        let (a, b) = (corners[k], corners[(k + 1) % 3]);
                        normal.cross(b - a).normalize().dot(place - a)
                    });
                    let least = inside.fold(f32::INFINITY, f32::min);
                    assert!(least > -0.02 * surfel.radius, "{i}: {least} of {}", surfel.radius);
                }
            }
            assert!((area_of(&surfels) / (2.0 * 0.5 * normal_area(corners)) - 1.0).abs() < 1e-5);
            match spacing {
                10.0 => assert_eq!(kinds, [0, 2], "a small triangle is its own micropolygon"),
                _ => assert!(kinds[0] > 0 && kinds[1] > 0, "{kinds:?}"),
            }
        }
    }

    /// Area of the parallelogram over two edges of a triangle.
    fn normal_area([a, b, c]: [Vec3; 3]) -> f64 {
        f64::from((b - a).cross(c - a).length())
    }

    #[test]
    fn rectangles_are_cut_as_one() {
        let linen =
            Material { base_color: [1.0; 3], base_color_texture: Some(0), ..Material::default() };
        let texels = (0..64).map(|i| [(i % 8 * 32) as u8, (i / 8 * 32) as u8, 0, 255]);
        let texture = Texture::new(8, 8, texels.collect(), false).unwrap();
        let scene = |mesh: Mesh| {
            let mut scene = scene_of(mesh, linen.clone());
            scene.textures.push(texture.clone());
            scene
        };
        let tiled = |mesh: Mesh| {
            let surfels = dice(&scene(mesh), Spacing::Length(0.05), TwoSided::None);
            assert!((area_of(&surfels) - 1.0).abs() < 1e-5);
            let tiles = surfels.iter().filter(|s| s.half_edges().is_some()).count();
            (surfels, tiles == 400)
        };
        // Wherever the triangles start, the texture lies on them as on two.
        for (a, b) in (0..9).map(|k| (k / 3, k % 3)) {
            let mut mesh = square();
            mesh.triangles[0].rotate_left(a);
            mesh.triangles[1].rotate_left(b);
            let (surfels, whole) = tiled(mesh);
            assert!(whole && surfels.len() == 400);
            for surfel in &surfels {
                let (at, albedo) = (surfel.center(), surfel.albedo_rgb());
                if at.x.min(at.y) > 0.1 && at.x.max(at.y) < 0.9 {
                    for (x, found) in [(at.x, albedo[0]), (at.y, albedo[1])] {
                        let expected = (8.0 * x - 0.5) * 32.0 / 255.0;
                        assert!((found - expected).abs() < 0.02, "{at}: {albedo:?}");
                    }
                }
            }
        }
        // Neither texture nor colors linear, not flat, not parallel, no right angle: two triangles.
        let breaks: [fn(&mut Mesh); 2] = [
            |m| m.uvs[3].x += 0.01,
            |m| {
                m.colors = vec![[1.0; 3]; 4];
                m.colors[0] = [0.5; 3];
            },
        ];
        for break_mesh in breaks {
            let mut mesh = square();
            break_mesh(&mut mesh);
            assert!(!tiled(mesh).1);
        }
        for (corners, shift) in [
            (&[3][..], Vec3::new(0.0, 0.0, 0.001)),
            (&[3], Vec3::new(0.001, 0.0, 0.0)),
            (&[2, 3], Vec3::new(0.02, 0.0, 0.0)),
        ] {
            let mut mesh = square();
            corners.iter().for_each(|&c: &usize| mesh.positions[c] += shift);
            let surfels = dice(&scene(mesh), Spacing::Length(0.05), TwoSided::None);
            assert!(surfels.iter().any(|s| s.corners().is_some()));
        }
    }

    #[test]
    fn pairs_are_counted_as_they_are_read() {
        // A single triangle first, so that a pair meets the end of each run.
        let mut mesh = square();
        let pair = mesh.triangles.clone();
        mesh.triangles = vec![[0, 1, 3]];
        mesh.triangles.extend((0..3000).flat_map(|_| pair.clone()));
        let surfels =
            dice(&scene_of(mesh, Material::default()), Spacing::Length(0.5), TwoSided::None);
        // Four cells of a pair, three of a triangle: the first, one at the end of the first run, from where on pairs start at
        // the other triangle, and the last.
        assert_eq!(surfels.len(), 3 * 3 + 2999 * 4);
    }

    #[test]
    fn spacing_factors_thin_out_surfels() {
        let options = |factor: f32| {
            let material = Material { spacing_factor: factor, ..Material::default() };
            dice(&scene_of(square(), material), Spacing::Length(0.02), TwoSided::None)
        };
        let (fine, coarse) = (options(1.0), options(4.0));
        // Cells of 0.02, and of at most 0.08.
        assert_eq!((fine.len(), coarse.len()), (50 * 50, 13 * 13));
        assert!((area_of(&coarse) - 1.0).abs() < 1e-6);
        let bad = Material { spacing_factor: 0.0, ..Material::default() };
        let bad = scene_of(square(), bad);
        let dicing = DiceOptions { spacing: Spacing::Count(100), two_sided: TwoSided::None };
        assert!(DicedScene::new(&bad, dicing).is_err());
    }

    #[test]
    fn counts_are_met_within_two_percent() {
        let cloth = Material { double_sided: true, ..Material::default() };
        let mut scene = scene_of(sphere(24), cloth);
        // Unlike triangles do not jump to the next count together.
        scene.instances[0].transform = Affine3A::from_scale(Vec3::new(1.0, 1.9, 0.5));
        for (two_sided, target) in [(TwoSided::None, 50_000), (TwoSided::Material, 80_000)] {
            let count = dice(&scene, Spacing::Count(target), two_sided).len() as f64;
            assert!((count / target as f64 - 1.0).abs() < 0.02, "{count}");
        }
        // One per triangle is the least; the two rings at the poles have half as many.
        assert_eq!(dice(&scene, Spacing::Count(5), TwoSided::None).len(), 24 * 48 * 2 - 2 * 48);
    }

    #[test]
    fn two_sided_surfaces_give_surfels_back_to_back() {
        let lamp = Material { emission: [3.0, 2.0, 1.0], ..Material::default() };
        let cloth = Material { double_sided: true, ..lamp.clone() };
        for (material, two_sided, back) in [
            (&lamp, TwoSided::Material, None),
            (&lamp, TwoSided::None, None),
            (&cloth, TwoSided::None, None),
            (&cloth, TwoSided::Material, Some([3.0, 2.0, 1.0])),
            (&lamp, TwoSided::All, Some([0.0; 3])),
        ] {
            let scene = scene_of(square(), material.clone());
            let surfels = dice(&scene, Spacing::Length(0.2), two_sided);
            assert_eq!(surfels.len(), if back.is_some() { 50 } else { 25 });
            for (i, surfel) in surfels.iter().enumerate() {
                let is_back = back.is_some() && i % 2 == 1;
                assert_eq!(surfel.is_front_only(), back.is_some());
                assert!((surfel.normal().z - if is_back { -1.0 } else { 1.0 }).abs() < 1e-6);
                let expected = if is_back { back.unwrap() } else { [3.0, 2.0, 1.0] };
                assert_eq!(surfel.radiance, expected);
                assert_eq!(surfel.position, surfels[i & !usize::from(is_back)].position);
            }
        }
    }

    #[test]
    fn mirrored_instances_keep_their_front() {
        let mut scene = scene_of(sphere(6), Material::default());
        let mirror = Mat3::from_diagonal(Vec3::new(-2.0, 1.0, 1.0));
        scene.instances[0].transform = Affine3A::from_mat3_translation(mirror, Vec3::X * 10.0);
        assert!(scene.instances[0].flips());
        for surfel in dice(&scene, Spacing::Length(0.3), TwoSided::None) {
            assert!(surfel.normal().dot(surfel.center() - Vec3::X * 10.0) > 0.0);
        }
    }

    #[test]
    fn textures_and_vertex_colors_reach_the_albedo() {
        let texels = (0..64).map(|i| if i % 8 < 4 { [255, 0, 0, 9] } else { [0, 255, 0, 9] });
        let texture = Texture::new(8, 8, texels.collect(), true).unwrap();
        let material = Material {
            base_color: [0.5; 3],
            base_color_texture: Some(0),
            metallic: 0.25,
            ..Material::default()
        };
        let mut mesh = square();
        mesh.colors = vec![[1.0, 0.5, 1.0]; 4];
        let mut scene = scene_of(mesh, material);
        scene.textures.push(texture);
        for surfel in dice(&scene, Spacing::Length(0.02), TwoSided::None) {
            let [r, g, b] = surfel.albedo_rgb();
            match surfel.center().x {
                x if x > 0.1 && x < 0.4 => assert!((r - 0.375).abs() < 1e-3 && g == 0.0),
                x if x > 0.6 && x < 0.9 => assert!((g - 0.1875).abs() < 1e-3 && r == 0.0),
                _ => assert!(b == 0.0),
            }
        }
        // One surfel for each half of the square: the average of the texture.
        for surfel in dice(&scene, Spacing::Length(2.0), TwoSided::None) {
            let [r, g, _] = surfel.albedo_rgb();
            assert!((r / 0.1875 - 1.0).abs() < 0.4 && (g / 0.09375 - 1.0).abs() < 0.4);
        }
    }

    #[test]
    fn holes_take_area_away() {
        // The left half is a hole.
        let texels = (0..64).map(|i| [255, 255, 255, if i % 8 < 4 { 0 } else { 255 }]);
        let material = Material {
            base_color_texture: Some(0),
            alpha_cutoff: Some(0.5),
            double_sided: true,
            ..Material::default()
        };
        let mut scene = scene_of(square(), material);
        scene.textures.push(Texture::new(8, 8, texels.collect(), true).unwrap());
        for spacing in [0.007, 0.05, 0.3, 0.9] {
            let surfels = dice(&scene, Spacing::Length(spacing), TwoSided::Material);
            assert!((area_of(&surfels) / 2.0 - 0.5).abs() < 0.05, "{}", area_of(&surfels));
            let whole = dice(&scene, Spacing::Length(spacing), TwoSided::None).len();
            assert_eq!(surfels.len(), 2 * whole);
            assert!(surfels.iter().all(|s| s.flags.contains(SurfelFlags::FRONT_ONLY)));
        }
        let target = Spacing::Count(20_000);
        let count = dice(&scene, target, TwoSided::Material).len() as f64;
        assert!((count / 20_000.0 - 1.0).abs() < 0.03, "{count}");
        // A cutoff above 1 without a texture: all hole.
        scene.materials[0] = Material { alpha_cutoff: Some(1.5), ..Material::default() };
        assert!(dice(&scene, Spacing::Length(0.1), TwoSided::All).is_empty());
    }

    #[test]
    fn surfaces_that_are_all_hole_end_at_once() {
        let glass = |alphas: &[f32], cutoff| {
            let material = Material { alpha_cutoff: Some(cutoff), ..Material::default() };
            let mesh = Mesh { alphas: alphas.to_vec(), ..square() };
            scene_of(mesh, Material { name: "glass".into(), ..material })
        };
        let clear = |alpha| Texture::new(2, 1, vec![[0, 0, 0, alpha]; 2], true).unwrap();
        let mut textured = glass(&[], 0.5);
        textured.materials[0].base_color_texture = Some(0);
        textured.textures.push(clear(100));
        for (scene, is_hole) in [
            (glass(&[], f32::INFINITY), true),
            (glass(&[0.2; 4], 0.5), true),
            (glass(&[0.2, 0.2, 0.2, 0.6], 0.5), false),
            (glass(&[], 0.9), false),
            (textured, true),
        ] {
            for spacing in [Spacing::Count(2000), Spacing::Length(1e-6)] {
                if !is_hole && spacing == Spacing::Length(1e-6) {
                    continue;
                }
                let options = DiceOptions { spacing, two_sided: TwoSided::None };
                let diced = DicedScene::new(&scene, options).unwrap();
                assert_eq!(diced.count() == Some(0), is_hole, "{:?}", diced.count());
                let names: &[&str] = if is_hole { &["glass"] } else { &[] };
                assert_eq!(diced.hole_materials(), names);
            }
        }
    }

    /// A frame of a ten thousandth of the square: one texel of many.
    #[test]
    fn little_between_holes_is_found_within_bounds() {
        let mut texels = vec![[255, 255, 255, 0]; 128 * 128];
        texels[64 * 128 + 64] = [255; 4];
        let material = Material {
            base_color_texture: Some(0),
            alpha_cutoff: Some(0.5),
            ..Material::default()
        };
        let mut scene = scene_of(square(), material);
        scene.textures.push(Texture::new(128, 128, texels, true).unwrap());
        for target in [100, 10_000, 200_000] {
            let options =
                DiceOptions { spacing: Spacing::Count(target), two_sided: TwoSided::None };
            let mut diced = DicedScene::new(&scene, options).unwrap();
            let count = diced.count().unwrap();
            assert!((count as f64 / target as f64 - 1.0).abs() < 0.1, "{count} of {target}");
            let surfels = read_all(&mut diced);
            assert_eq!(surfels.len() as u64, count);
            // Bilinear alpha is above one half in a square of a texel, rounded at its corners.
            let texels = area_of(&surfels) * 128.0 * 128.0;
            assert!((0.5..1.1).contains(&texels), "{texels}");
        }
    }

    /// Rows of holes are work, too: a strip of them, of which no part is a hole for sure, as the strip ends in what is none, is not searched without end.
    #[test]
    fn rows_of_holes_are_searched_within_bounds() {
        let texels = [[0; 4], [255; 4]].into_iter().cycle().take(64).collect();
        let material = Material {
            base_color_texture: Some(0),
            alpha_cutoff: Some(0.999),
            ..Material::default()
        };
        let mut mesh = square();
        mesh.positions[2].y = 1.2e24;
        mesh.positions[3].y = 1.2e24;
        let mut scene = scene_of(mesh, material);
        scene.textures.push(Texture::new(8, 8, texels, true).unwrap());
        let stop = AtomicBool::new(false);
        let meshes =
            Meshes { scene: &scene, two_sided: TwoSided::None, holes: vec![false], stop: &stop };
        assert!(meshes.count_surfels(1e-3, 100_000).is_none());
    }

    #[test]
    fn dicing_stops_when_it_is_told_to() {
        let stop = AtomicBool::new(true);
        let options = DiceOptions { spacing: Spacing::Count(100), two_sided: TwoSided::None };
        let scene = scene_of(square(), Material::default());
        assert!(matches!(DicedScene::new_until(&scene, options, &stop), Err(DiceError::Stopped)));
    }

    /// The right half fades from 1 to 0: of the whole, three quarters are above one half.
    #[test]
    fn alpha_of_vertices_cuts_holes() {
        let material = Material { alpha_cutoff: Some(0.5), ..Material::default() };
        let mesh = Mesh { alphas: vec![1.0, 0.25, 0.25, 1.0], ..square() };
        let scene = scene_of(mesh, material);
        let surfels = dice(&scene, Spacing::Length(0.01), TwoSided::None);
        // 1 − 0.75 x = 0.5 at x = 2/3.
        assert!((area_of(&surfels) * 1.5 - 1.0).abs() < 0.02, "{}", area_of(&surfels));
        assert!(surfels.iter().all(|s| s.center().x < 0.68));
    }

    #[test]
    fn rewinding_and_threads_change_nothing() {
        let scene = scene_of(sphere(30), Material::default());
        let options = DiceOptions { spacing: Spacing::Count(30_000), two_sided: TwoSided::None };
        let mut diced = DicedScene::new(&scene, options).unwrap();
        let first = read_all(&mut diced);
        diced.rewind();
        assert_eq!(first, read_all(&mut diced));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let single = pool.install(|| DicedScene::new(&scene, options)).unwrap();
        assert_eq!(diced.area().to_bits(), single.area().to_bits());
        assert_eq!(diced.spacing().to_bits(), single.spacing().to_bits());
    }

    #[test]
    fn broken_scenes_are_refused() {
        let sound = scene_of(square(), Material::default());
        let refused = |scene: &Scene, spacing| {
            DicedScene::new(scene, DiceOptions { spacing, two_sided: TwoSided::None }).is_err()
        };
        for length in [0.0, -1.0, f32::NAN] {
            assert!(refused(&sound, Spacing::Length(length)));
        }
        let breaks: [fn(&mut Scene); 4] = [
            |s| s.instances[0].mesh = 1,
            |s| s.meshes[0].material = 1,
            |s| s.meshes[0].triangles[1][2] = 4,
            |s| s.materials[0].emission_texture = Some(0),
        ];
        for break_scene in breaks {
            let mut scene = sound.clone();
            break_scene(&mut scene);
            assert!(refused(&scene, Spacing::Length(0.1)));
        }
        let empty = Scene::default();
        assert!(dice_empty(&empty).is_empty());
    }

    fn dice_empty(scene: &Scene) -> Vec<Surfel> {
        let options = DiceOptions { spacing: Spacing::Count(100), two_sided: TwoSided::None };
        let mut diced = DicedScene::new(scene, options).unwrap();
        assert_eq!(diced.bounds(), None);
        read_all(&mut diced)
    }

    #[test]
    #[ignore = "measures speed: cargo test --release -p pbgi-scene dicing_speed -- --ignored --nocapture"]
    fn dicing_speed() {
        for (name, rings, count) in [("large", 4, 4_000_000), ("small", 1000, 4_000_000)] {
            let scene = scene_of(sphere(rings), Material::default());
            let options = DiceOptions { spacing: Spacing::Count(count), two_sided: TwoSided::None };
            let mut diced = DicedScene::new(&scene, options).unwrap();
            let start = std::time::Instant::now();
            let (mut chunk, mut total, mut more) = (vec![], 0, true);
            while more {
                more = diced.read_chunk(&mut chunk).unwrap();
                total += chunk.len();
                chunk.clear();
            }
            let seconds = start.elapsed().as_secs_f64();
            println!("{name} triangles: {:.1} M surfels/s", total as f64 / seconds * 1e-6);
        }
    }
}
