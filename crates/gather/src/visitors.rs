//! The cut, drawn into the cube.

use crate::lamps::{Lamps, is_lamp};
use crate::primitive::{DrawSurfel, Outline, SurfelPen, piece_ink, piece_shape, surfel_ink};
use pbgi_cut::{Boxes, Cluster, CutVisitor, Kept, NOTHING_KEPT, SurfelSeen};
use pbgi_format::CHILDREN_MAX;
use pbgi_math::Vec3;
use pbgi_raster::{CubeRaster, Ink, Lanes, NO_FOOTPRINT_CODE, Shape};
use std::marker::PhantomData;

/// Of boxes whose footprint has no code nothing is kept.
const _: () = assert!(NO_FOOTPRINT_CODE == NOTHING_KEPT);

/// Draws the cut into the cube.
pub(crate) struct CubeVisitor<'a, L> {
    pub raster: &'a mut CubeRaster,
    pub lamps: &'a Lamps,
    /// Of the receiver's surface.
    pub plane: Vec3,
    pub lanes: PhantomData<L>,
}

impl<L: Lanes> CubeVisitor<'_, L> {
    /// Draws a shape whose middle is `toward`.
    #[inline(always)]
    fn put<S: Shape>(&mut self, shape: &S, mut ink: Ink, toward: Vec3) {
        if is_lamp(ink.radiance, self.lamps.least) {
            ink.lamp = Some(self.lamps.number_at(toward));
        }
        self.raster.draw::<L, S>(shape, &ink, toward);
    }
}

impl<L: Lanes> CutVisitor for CubeVisitor<'_, L> {
    #[inline(always)]
    fn look_at(&self, boxes: &Boxes) -> [Kept; CHILDREN_MAX] {
        self.raster.footprint_codes(&boxes.low, &boxes.high)
    }

    #[inline(always)]
    fn is_open(&mut self, low: Vec3, high: Vec3, kept: Kept) -> bool {
        self.raster.look(kept, low, high)
    }

    #[inline(always)]
    fn take_cluster(&mut self, cluster: &Cluster) {
        let toward = (cluster.low + cluster.high) * 0.5;
        for piece in cluster.pieces() {
            let (section, veil) = piece_shape(cluster, piece);
            self.put(&section, piece_ink(cluster, piece, veil), toward);
        }
    }

    #[inline(always)]
    fn take_surfel(&mut self, seen: &SurfelSeen<'_>) {
        L::run_part(DrawSurfel { seen, plane: self.plane, pen: self });
    }

    #[inline(always)]
    fn minds_order(&self) -> bool {
        self.raster.minds_order()
    }
}

impl<L: Lanes> SurfelPen for CubeVisitor<'_, L> {
    #[inline(always)]
    fn draw<S: Shape>(&mut self, seen: &SurfelSeen<'_>, shape: &S, outline: &Outline) {
        let [low, high] = seen.bounds();
        if self.raster.look(seen.kept, low, high) || self.raster.shines() {
            self.put(shape, surfel_ink(seen, outline), seen.center);
        }
    }
}
