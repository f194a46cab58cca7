//! The cut, drawn into rasters.

use crate::primitive::{Outline, SurfelPen, draw_surfel, piece_ink, piece_shape, surfel_ink};
use pbgi_cut::{Boxes, Cluster, CutVisitor, Kept, NOTHING_KEPT, SurfelSeen};
use pbgi_format::CHILDREN_MAX;
use pbgi_math::Vec3;
use pbgi_raster::{
    CubeRaster, Footprint, Ink, Lanes, NO_FOOTPRINT_CODE, SHAPES_MAX, Section, Shape, Veil, Window,
    WindowRaster,
};
use std::marker::PhantomData;

/// Of boxes whose footprint has no code nothing is kept.
const _: () = assert!(NO_FOOTPRINT_CODE == NOTHING_KEPT);

/// Draws the cut into the cube.
pub(crate) struct CubeVisitor<'a, L> {
    pub raster: &'a mut CubeRaster,
    /// Of the box that was asked about last.
    pub footprint: Footprint,
    /// Of the receiver's surface.
    pub plane: Vec3,
    pub lanes: PhantomData<L>,
}

impl<L: Lanes> CutVisitor for CubeVisitor<'_, L> {
    #[inline(always)]
    fn look_at(&self, boxes: &Boxes) -> [Kept; CHILDREN_MAX] {
        self.raster.footprint_codes(&boxes.low, &boxes.high)
    }

    #[inline(always)]
    fn is_open(&mut self, low: Vec3, high: Vec3, kept: Kept) -> bool {
        self.footprint = self.raster.footprint_of(kept, low, high);
        self.raster.is_open(&self.footprint)
    }

    #[inline(always)]
    fn take_cluster(&mut self, cluster: &Cluster) {
        let mut shapes = [(Section::default(), Ink::default()); SHAPES_MAX];
        let pieces = cluster.pieces();
        for (shape, piece) in shapes.iter_mut().zip(pieces) {
            let (section, veil) = piece_shape(cluster, piece);
            *shape = (section, piece_ink(cluster, piece, veil));
        }
        let toward = cluster.low + cluster.high;
        self.raster.draw::<L, _>(&shapes[..pieces.len()], &self.footprint, toward);
    }

    #[inline(always)]
    fn take_surfel(&mut self, seen: &SurfelSeen<'_>) {
        draw_surfel(seen, self.plane, self);
    }

    /// What covers first says how far away a sample is, and light alone asks for it.
    #[inline(always)]
    fn minds_order(&self) -> bool {
        self.raster.shines()
    }
}

impl<L: Lanes> SurfelPen for CubeVisitor<'_, L> {
    #[inline(always)]
    fn draw<S: Shape>(&mut self, seen: &SurfelSeen<'_>, shape: &S, outline: &Outline) {
        let [low, high] = seen.bounds();
        let footprint = self.raster.footprint_of(seen.kept, low, high);
        if !self.raster.shines() && !self.raster.is_open(&footprint) {
            return;
        }
        let ink = surfel_ink(seen, outline);
        self.raster.draw::<L, S>(&[(*shape, ink)], &footprint, seen.center);
    }
}

/// Draws what blocks a window.
pub(crate) struct WindowVisitor<'a, L> {
    pub raster: &'a mut WindowRaster,
    pub window: &'a Window,
    pub plane: Vec3,
    pub lanes: PhantomData<L>,
}

impl<L: Lanes> CutVisitor for WindowVisitor<'_, L> {
    #[inline(always)]
    fn is_open(&mut self, low: Vec3, high: Vec3, _: Kept) -> bool {
        !self.raster.is_closed() && self.window.is_met_by(low, high)
    }

    #[inline(always)]
    fn take_cluster(&mut self, cluster: &Cluster) {
        for piece in cluster.pieces() {
            let (section, veil) = piece_shape(cluster, piece);
            self.raster.draw::<L, _>(self.window, &section, &veil);
        }
    }

    #[inline(always)]
    fn take_surfel(&mut self, seen: &SurfelSeen<'_>) {
        draw_surfel(seen, self.plane, self);
    }

    #[inline(always)]
    fn minds_order(&self) -> bool {
        false
    }
}

impl<L: Lanes> SurfelPen for WindowVisitor<'_, L> {
    #[inline(always)]
    fn draw<S: Shape>(&mut self, seen: &SurfelSeen<'_>, shape: &S, outline: &Outline) {
        let [low, high] = seen.bounds();
        if self.window.is_met_by(low, high) {
            let veil = Veil { start: 0.0, end: outline.opacity, seed: seen.seed };
            self.raster.draw::<L, S>(self.window, shape, &veil);
        }
    }
}
