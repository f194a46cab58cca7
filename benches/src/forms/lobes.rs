//! Forms made of sums of surfels: our lobes, and the flat cluster.

use crate::harmonics::{mean_radiance, round_size};
use crate::target::{FUNCTIONS, Shown, Sphere, Target};
use pbgi_build::LobeSum;
use pbgi_format::{Channels, Lobe, MiniFloat};
use pbgi_math::{Aabb, DVec3, Vec3, decode_octahedral24, encode_octahedral24};

/// What lobes show, summed.
fn show_lobes(lobes: &[Lobe], sphere: &Sphere) -> Shown {
    let show = |d: &Vec3| {
        let mut shown = [0.0; FUNCTIONS];
        for lobe in lobes {
            let front = lobe.front_area(*d);
            let [r, g, b] = lobe.radiance.map(|c| c * front);
            let parts = [front + lobe.back_area(*d), r, g, b];
            shown.iter_mut().zip(parts).for_each(|(sum, part)| *sum += part);
        }
        shown
    };
    sphere.directions.iter().map(show).collect()
}

/// Lobes as they come back from a file.
fn stored(sums: &[LobeSum]) -> Vec<Lobe> {
    let read = |sum: &LobeSum| {
        // Where the plane lies does not matter here.
        let lobe = sum.to_lobe(&Aabb { min: Vec3::ZERO, max: Vec3::ONE });
        let area = MiniFloat::covering(lobe.vector.length() + lobe.width);
        let largest = lobe.radiance.into_iter().fold(f32::MIN_POSITIVE, f32::max);
        let scale = (largest / 1024.0).log2().ceil().exp2();
        let mut bytes = Vec::new();
        lobe.write(Channels::Rgb, area, scale, &mut bytes);
        Lobe::read(&bytes, Channels::Rgb, area, scale)
    };
    sums.iter().map(read).collect()
}

fn sum_of(a: &LobeSum, b: &LobeSum) -> LobeSum {
    let mut sum = *a;
    sum.add(b);
    sum
}

/// The node's lobes, summed until at most `most` are left or none may be summed; the pair first that changes least what is shown. Returns
/// their number, too.
pub fn show_at_most(target: &Target, most: usize, sphere: &Sphere) -> (Shown, usize) {
    let mut sums = target.lobes.clone();
    while sums.len() > most {
        let mut best: Option<(f64, Vec<LobeSum>)> = None;
        for i in 0..sums.len() {
            for j in (i + 1..sums.len()).filter(|j| sums[*j].blocks_back == sums[i].blocks_back) {
                let mut fewer = sums.clone();
                fewer[i] = sum_of(&sums[i], &fewer.remove(j));
                let shown = show_lobes(&stored(&fewer), sphere);
                let change = crate::errors::errors(&shown, &target.exact).combined();
                if best.as_ref().is_none_or(|(least, _)| change < *least) {
                    best = Some((change, fewer));
                }
            }
        }
        let Some((_, fewer)) = best else { break };
        sums = fewer;
    }
    (show_lobes(&stored(&sums), sphere), sums.len())
}

/// One disk of the area and mean normal of all surfels, which blocks on both sides where most of them do.
pub fn show_flat(target: &Target, sphere: &Sphere) -> Shown {
    let sum = |f: &dyn Fn(&LobeSum) -> f64| target.lobes.iter().map(f).sum::<f64>();
    let vector: DVec3 = target.lobes.iter().map(|l| l.vector).sum();
    let area = sum(&|l| l.area);
    let normal = decode_octahedral24(encode_octahedral24(vector.normalize_or(DVec3::Z).as_vec3()));
    let blocks_back = 2.0 * sum(&|l| if l.blocks_back { l.area } else { 0.0 }) > area;
    let flux: [f64; 3] = std::array::from_fn(|c| sum(&|l| l.flux[c]));
    let totals = [area, flux[0], flux[1], flux[2]].map(|x| x as f32);
    let lobe = Lobe {
        vector: normal * round_size(area as f32),
        blocks_back,
        radiance: mean_radiance(totals),
        ..Lobe::default()
    };
    show_lobes(&[lobe], sphere)
}
