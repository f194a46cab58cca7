//! Which lobes a node keeps: like ones are summed, the most alike first.

use crate::lobe_sum::LobeSum;
use crate::loose::LooseFinder;
use pbgi_cloud::Surfel;
use pbgi_format::LOBES_MAX;
use pbgi_math::luminance;
use std::ops::Deref;

/// The lobes of a node, at most [`LOBES_MAX`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LobeSums {
    lobes: [LobeSum; LOBES_MAX],
    len: usize,
}

impl std::ops::DerefMut for LobeSums {
    fn deref_mut(&mut self) -> &mut [LobeSum] {
        &mut self.lobes[..self.len]
    }
}

impl Deref for LobeSums {
    type Target = [LobeSum];

    fn deref(&self) -> &[LobeSum] {
        &self.lobes[..self.len]
    }
}

/// Contrast `(L − M)/(L + M)` above which one surface is a lamp beside the other: eight to one.
const LAMP_CONTRAST: f64 = 7.0 / 9.0;

/// Lobes that sum with less loss than this share of their node's area are taken for the same at once.
const SAME_TOLERANCE: f64 = 1e-4;

/// Lobes that sum with less loss than this share of their node's area do so even where there is
/// room for more.
const MERGE_TOLERANCE: f64 = 0.01;

/// A lobe with what is asked of it again and again.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    sum: LobeSum,
    /// `|Σ aᵢ nᵢ|`.
    length: f64,
    /// Luminance of the mean radiance.
    luminance: f32,
    /// The candidate behind this one that it sums with at the least loss, and that loss; infinite where there is none.
    nearest: usize,
    loss: f64,
}

impl Candidate {
    fn new(sum: LobeSum) -> Self {
        let (length, luminance) = (sum.vector.length(), luminance(sum.radiance()));
        Self { sum, length, luminance, nearest: 0, loss: f64::INFINITY }
    }

    /// What is lost by summing two lobes, in units of area; infinite where they must stay apart.
    ///
    /// Parallel lobes of similar radiance sum without loss; else the loss is the part of the vector areas that cancels,
    /// weighted up by the contrast of their radiance, plus a term for a flat lobe meeting a round one, and one
    /// that keeps lamps apart from the walls they hang on: what shines must not be averaged with what it hides.
    fn loss_with(&self, other: &Self) -> f64 {
        let (a, b) = (&self.sum, &other.sum);
        if a.blocks_back != b.blocks_back {
            return f64::INFINITY;
        }
        let (v, w) = (self.length, other.length);
        let cancelled = v + w - (a.vector + b.vector).length();
        let (l, m) = (self.luminance, other.luminance);
        if l == m || a.seen == 0.0 || b.seen == 0.0 {
            return cancelled;
        }
        let contrast = if l + m > 0.0 { f64::from((l - m).abs() / (l + m)) } else { 0.0 };
        let roundness = (v / a.area - w / b.area).abs() * a.area.min(b.area);
        // Share of the light of both that the lamp shines, and the sum would shine from all of the other's area, too.
        let fluxes = [f64::from(l) * a.seen, f64::from(m) * b.seen];
        let (lamp, dark) = if l > m { (fluxes[0], b.seen) } else { (fluxes[1], a.seen) };
        let displaced = lamp / (fluxes[0] + fluxes[1]) * dark;
        let glare = ((contrast - LAMP_CONTRAST) / (1.0 - LAMP_CONTRAST)).max(0.0);
        cancelled * (1.0 + 2.0 * contrast) + 0.25 * contrast * roundness + glare * displaced
    }
}

/// Lobes being reduced, in memory that is used again for the next node.
#[derive(Debug, Default)]
pub(crate) struct LobeReducer {
    candidates: Vec<Candidate>,
    /// The candidate that [`LobeReducer::add_to`] has changed, if any.
    stale: Option<usize>,
    /// For each lobe that was added, the candidate it is part of.
    pub owners: Vec<u32>,
    finder: LooseFinder,
    /// For each surfel of the leaf, whether it is loose.
    pub loose: Vec<bool>,
}

impl LobeReducer {
    /// Finds out which surfels of a leaf are loose.
    pub fn find_loose(&mut self, surfels: &[Surfel]) {
        self.finder.find(surfels, &mut self.loose);
    }

    /// Forgets the lobes of the node before.
    pub fn clear(&mut self) {
        self.candidates.clear();
        self.owners.clear();
        self.stale = None;
    }

    fn refresh(&mut self, place: usize) {
        self.candidates[place] = Candidate::new(self.candidates[place].sum);
    }

    fn refresh_stale(&mut self) {
        if let Some(place) = self.stale.take() {
            self.refresh(place);
        }
    }

    /// Adds a lobe of a node with the area `total`, to the first that is the same or as one more. Returns the place.
    pub fn add(&mut self, lobe: &LobeSum, total: f64) -> usize {
        self.refresh_stale();
        let new = Candidate::new(*lobe);
        // Most lobes of a flat piece are parallel; they need no search.
        let near = |kept: &Candidate| kept.loss_with(&new) <= SAME_TOLERANCE * total;
        let place = match self.candidates.iter().position(near) {
            Some(place) => {
                self.candidates[place].sum.add(lobe);
                self.refresh(place);
                place
            }
            None => {
                self.candidates.push(new);
                self.candidates.len() - 1
            }
        };
        self.owners.push(place as u32);
        place
    }

    /// Adds a lobe that differs from the last one only in area and place to the candidate where that went.
    #[inline]
    pub fn add_to(&mut self, place: usize, lobe: &LobeSum) {
        self.candidates[place].sum.add(lobe);
        self.owners.push(place as u32);
        self.stale = Some(place);
    }

    /// Sums lobes until at most [`LOBES_MAX`] remain and no two of them are nearly alike. Greedy: the
    /// pair with the least loss first, ties to the lowest indices.
    pub fn reduce(&mut self, total: f64) -> LobeSums {
        self.refresh_stale();
        for i in 0..self.candidates.len() {
            self.find_nearest(i);
        }
        while self.candidates.len() > 1 {
            let kept = self.candidates.len();
            let mut best = 0;
            for i in 1..kept {
                if self.candidates[i].loss < self.candidates[best].loss {
                    best = i;
                }
            }
            let loss = self.candidates[best].loss;
            if !loss.is_finite() || (kept <= LOBES_MAX && loss > MERGE_TOLERANCE * total) {
                break;
            }
            let other = self.candidates[best].nearest;
            self.merge(best, other);
        }
        let mut sums = LobeSums::default();
        for candidate in self.candidates.iter().take(LOBES_MAX) {
            sums.lobes[sums.len] = candidate.sum;
            sums.len += 1;
        }
        sums
    }

    /// Finds the candidate behind the one at `place` that it sums with best.
    fn find_nearest(&mut self, place: usize) {
        let (mut nearest, mut loss) = (0, f64::INFINITY);
        for (i, other) in self.candidates.iter().enumerate().skip(place + 1) {
            let with = self.candidates[place].loss_with(other);
            if with < loss {
                (nearest, loss) = (i, with);
            }
        }
        let candidate = &mut self.candidates[place];
        (candidate.nearest, candidate.loss) = (nearest, loss);
    }

    /// Sums two candidates into the first of them.
    fn merge(&mut self, first: usize, second: usize) {
        let other = self.candidates.remove(second).sum;
        for owner in &mut self.owners {
            if *owner == second as u32 {
                *owner = first as u32;
            } else if *owner > second as u32 {
                *owner -= 1;
            }
        }
        self.candidates[first].sum.add(&other);
        self.refresh(first);
        for i in 0..self.candidates.len() {
            let Candidate { nearest, loss, .. } = self.candidates[i];
            if i == first || (loss.is_finite() && (nearest == first || nearest == second)) {
                self.find_nearest(i);
                continue;
            }
            if nearest > second {
                self.candidates[i].nearest -= 1;
            }
            if i < first {
                let with = self.candidates[i].loss_with(&self.candidates[first]);
                let candidate = &mut self.candidates[i];
                if with < candidate.loss || (with == candidate.loss && first < candidate.nearest) {
                    (candidate.nearest, candidate.loss) = (first, with);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_math::{Aabb, DVec3};

    /// The same by looking at all pairs again after each sum.
    fn reduce_by_all_pairs(mut kept: Vec<LobeSum>, total: f64) -> Vec<LobeSum> {
        while kept.len() > 1 {
            let mut best = (f64::INFINITY, 0, 0);
            for i in 0..kept.len() {
                for j in i + 1..kept.len() {
                    let loss = Candidate::new(kept[i]).loss_with(&Candidate::new(kept[j]));
                    if loss < best.0 {
                        best = (loss, i, j);
                    }
                }
            }
            let (loss, i, j) = best;
            if !loss.is_finite() || (kept.len() <= LOBES_MAX && loss > MERGE_TOLERANCE * total) {
                break;
            }
            let other = kept.remove(j);
            kept[i].add(&other);
        }
        kept
    }

    /// A lobe of a flat piece.
    fn flat(normal: DVec3, area: f64, light: f64) -> LobeSum {
        LobeSum {
            vector: normal * area,
            area,
            flux: [light * area; 3],
            seen: area,
            seen_moment: DVec3::ZERO,
            blocks_back: true,
            covered: area,
            ..LobeSum::default()
        }
    }

    #[test]
    fn a_small_lamp_in_a_lit_room_stays_apart() {
        // A lamp of a twentieth of its ceiling, which is lit as the other walls are; and one that is so dim that it may go with the ceiling.
        for (light, expected) in [(16.0, true), (0.3, false)] {
            let axes = [DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X, DVec3::NEG_Y, DVec3::NEG_Z];
            let mut lobes = axes.map(|normal| flat(normal, 1.0, 0.1)).to_vec();
            lobes.push(flat(DVec3::NEG_Y, 0.05, light));
            let mut reducer = LobeReducer::default();
            for lobe in &lobes {
                reducer.add(lobe, 6.05);
            }
            let kept = reducer.reduce(6.05);
            let is_kept = |lobe: &LobeSum| f64::from(luminance(lobe.radiance())) > 0.9 * light;
            assert_eq!(kept.iter().any(is_kept), expected, "{light}: {:?}", &kept[..]);
        }
    }

    #[test]
    fn sums_are_those_of_looking_at_all_pairs() {
        let mut seed = 5u64;
        let mut random = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 11) as f64 / (1u64 << 53) as f64
        };
        for round in 0..400 {
            let lobes: Vec<LobeSum> = (0..1 + round % 40)
                .map(|i| {
                    let area = 0.1 + random();
                    // Few directions and levels of light, so that many pairs are alike.
                    let axis = |r: f64| (r * 3.0).floor() - 1.0;
                    let normal = DVec3::new(axis(random()), axis(random()), 0.1).normalize();
                    let light = if random() < 0.1 { 90.0 } else { (random() * 4.0).floor() };
                    LobeSum {
                        vector: normal * area * (0.5 + 0.5 * random()),
                        area,
                        moment: DVec3::splat(i as f64) * area,
                        flux: [light * area; 3],
                        seen: area,
                        seen_moment: DVec3::splat(i as f64) * area,
                        blocks_back: round % 3 > 0 || i % 2 == 0,
                        covered: area,
                        bounds: Aabb::EMPTY,
                        ..LobeSum::default()
                    }
                })
                .collect();
            let total = lobes.iter().map(|l| l.area).sum();
            let mut reducer = LobeReducer::default();
            reducer.candidates.extend(lobes.iter().copied().map(Candidate::new));
            let reduced = reducer.reduce(total);
            assert_eq!(&reduced[..], &reduce_by_all_pairs(lobes, total)[..], "round {round}");
        }
    }
}
