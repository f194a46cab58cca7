//! Scales and places far from 1, and input that is none.

use super::shapes::{Chance, crowd};
use super::{
    CaseCloud, CaseReceiver, CaseScene, CaseSky, Engine, Found, HardCase, Refusal, refused, worse,
};
use pbgi_math::DVec3;
use std::fmt::Write;

/// Why powers of two change no bit.
const EXACT: &str =
    "a power of two changes exponents only; all that is compared is relative to the scene";

/// Why places far away change little.
const ORIGIN: &str = "coordinates are doubles relative to an origin near the scene: receivers and surfels are rounded by 2⁻²⁴ of the scene";

pub(super) const CASES: [HardCase; 15] = [
    HardCase {
        name: "scale-2^20",
        about: "a crowd in a box of edge 2, scaled by 2²⁰; results of the same crowd of edge 2, largest difference over the largest result",
        promise: 0.0,
        why: EXACT,
        limit: None,
        measure: |engine| scaled(engine, 20),
    },
    HardCase {
        name: "scale-2^29",
        about: "`scale-2^20` scaled by 2²⁹",
        promise: 0.0,
        why: EXACT,
        limit: None,
        measure: |engine| scaled(engine, 29),
    },
    HardCase {
        name: "scale-2^-20",
        about: "`scale-2^20` scaled by 2⁻²⁰",
        promise: 0.0,
        why: EXACT,
        limit: None,
        measure: |engine| scaled(engine, -20),
    },
    HardCase {
        name: "scale-2^-23",
        about: "`scale-2^20` scaled by 2⁻²³, the least that is taken",
        promise: 0.0,
        why: EXACT,
        limit: None,
        measure: |engine| scaled(engine, -23),
    },
    HardCase {
        name: "scale-2^32",
        about: "`scale-2^20` scaled by 2³²: refused (1 if it is shaded to numbers)",
        promise: 0.0,
        why: "the format's coordinates end at 2³¹; a bake says so and ends with 3",
        limit: None,
        measure: |engine| refused_scale(engine, 2f32.powi(32)),
    },
    HardCase {
        name: "scale-1e12",
        about: "`scale-2^20` scaled by 10¹²: refused",
        promise: 0.0,
        why: "the format's coordinates end at 2³¹; a bake says so and ends with 3",
        limit: None,
        measure: |engine| refused_scale(engine, 1e12),
    },
    HardCase {
        name: "scale-2^-40",
        about: "`scale-2^20` scaled by 2⁻⁴⁰: refused",
        promise: 0.0,
        why: "areas and their products would lose digits below 2⁻²³; a bake says so and ends with 3",
        limit: None,
        measure: |engine| refused_scale(engine, 2f32.powi(-40)),
    },
    HardCase {
        name: "at-1e7",
        about: "`scale-2^20` not scaled, but at 10⁷ along each axis; results of the same crowd at 0",
        promise: 1e-4,
        why: ORIGIN,
        limit: None,
        measure: |engine| moved(engine, DVec3::new(1e7, -1e7, 1e7), 0.0),
    },
    HardCase {
        name: "at-1e9",
        about: "`at-1e7` at 10⁹ along each axis",
        promise: 1e-4,
        why: ORIGIN,
        limit: None,
        measure: |engine| moved(engine, DVec3::new(1e9, -1e9, 1e9), 0.0),
    },
    HardCase {
        name: "doubles-at-1e7",
        about: "a crowd as a PLY file of doubles around 10⁷; results of the same file around 0",
        promise: 0.02,
        why: "coordinates of the file are relative to an origin that is rounded to the extent's step: the root's cells lie otherwise, and nodes \
            with them, which costs no more than the cut's error at defaults",
        limit: None,
        measure: doubles_far_away,
    },
    HardCase {
        name: "not-a-number",
        about: "a PLY file with a position that is no number: refused",
        promise: 0.0,
        why: "records are checked when they are read; --skip-invalid drops them",
        limit: None,
        measure: |engine| refused_row(engine, "nan 0 0 0 1 0 0.1", "position"),
    },
    HardCase {
        name: "infinite-radius",
        about: "a PLY file with an infinite radius: refused",
        promise: 0.0,
        why: "records are checked when they are read",
        limit: None,
        measure: |engine| refused_row(engine, "0 0 0 0 1 0 inf", "radius"),
    },
    HardCase {
        name: "radius-1e15",
        about: "a PLY file with a radius of 10¹⁵: refused",
        promise: 0.0,
        why: "sizes of the format end at 2³¹",
        limit: None,
        measure: |engine| refused_row(engine, "0 0 0 0 1 0 1e15", "scale the scene"),
    },
    HardCase {
        name: "normals-not-unit",
        about: "a PLY file whose normals are 10⁻⁵ to 10⁵ long; results of the same file with unit normals",
        promise: 0.0,
        why: "normals are normalized in double precision before they are stored in 24 bits, and lengths are powers of two here",
        limit: None,
        measure: odd_normals,
    },
    HardCase {
        name: "receivers-not-unit",
        about: "receivers whose normals are 10⁻⁵ to 10⁵ long; results of unit ones",
        promise: 0.0,
        why: "normals are normalized in double precision, and lengths are powers of two here",
        limit: None,
        measure: odd_receivers,
    },
];

/// Receivers in the crowd.
fn places() -> Vec<CaseReceiver> {
    let mut chance = Chance::new(3);
    let mut place = || CaseReceiver::diffuse(chance.place().as_dvec3(), chance.direction());
    (0..40).map(|_| place()).collect()
}

/// The crowd, scaled and moved.
fn scene(scale: f32, origin: DVec3) -> CaseScene {
    let mut surfels = crowd(2000, 0.03, 7);
    for surfel in &mut surfels {
        surfel.position = surfel.position.map(|x| x * scale);
        surfel.radius *= scale;
        surfel.area *= scale * scale;
    }
    let mut receivers = places();
    for receiver in &mut receivers {
        receiver.position = receiver.position * f64::from(scale) + origin;
    }
    let cloud = CaseCloud::Surfels { origin, surfels };
    CaseScene { cloud, receivers, sky: CaseSky::Uniform(1.0), solid_angle_sr: None }
}

/// Largest difference of results over the largest result; beyond all if all receivers have the same, which says nothing.
pub(super) fn difference(found: &[Found], right: &[Found], factor: f64) -> f64 {
    let all = |f: &Found| [f.surfaces, f.sky, f.open, f.reflected];
    let linear = |f: &Found| [f.surfaces * factor, f.sky, f.open, f.reflected];
    if found.len() != right.len() || right.windows(2).all(|pair| all(&pair[0]) == all(&pair[1])) {
        return f64::INFINITY;
    }
    let mut worst = 0.0;
    for channel in 0..4 {
        let largest = right.iter().map(|f| linear(f)[channel].abs()).fold(0.0, f64::max);
        for (found, right) in found.iter().zip(right) {
            let (found, right) = (all(found)[channel], linear(right)[channel]);
            if found != right {
                worst = worse(worst, (found - right).abs() / largest);
            }
        }
    }
    worst
}

fn scaled(engine: &mut dyn Engine, exponent: i32) -> Result<f64, Refusal> {
    let right = engine.shade(&scene(1.0, DVec3::ZERO))?;
    let found = engine.shade(&scene(2f32.powi(exponent), DVec3::ZERO))?;
    Ok(difference(&found, &right, 1.0))
}

fn refused_scale(engine: &mut dyn Engine, scale: f32) -> Result<f64, Refusal> {
    refused(engine, &scene(scale, DVec3::ZERO), 3, "scale the scene")
}

/// At another origin, and beside it, so that places are rounded otherwise.
fn moved(engine: &mut dyn Engine, origin: DVec3, beside: f64) -> Result<f64, Refusal> {
    let right = engine.shade(&scene(1.0, DVec3::ZERO))?;
    let found = engine.shade(&scene(1.0, origin + beside))?;
    Ok(difference(&found, &right, 1.0))
}

const COLUMNS: [&str; 7] = ["x", "y", "z", "nx", "ny", "nz", "radius"];

/// A PLY file of doubles.
fn ply(rows: &[String]) -> CaseCloud {
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", rows.len());
    for column in COLUMNS {
        let _ = writeln!(text, "property double {column}");
    }
    CaseCloud::Ply(text + "end_header\n" + &rows.join("\n") + "\n")
}

/// The crowd as a PLY file, at a place and with normals so long.
fn ply_scene(origin: DVec3, length: impl Fn(usize) -> f64) -> CaseScene {
    let surfels = crowd(2000, 0.03, 7);
    let row = |(i, s): (usize, &pbgi_cloud::Surfel)| {
        let ([x, y, z], n) = ((s.center().as_dvec3() + origin).to_array(), s.normal());
        let [u, v, w] = (n.as_dvec3() * length(i)).to_array();
        format!("{x:?} {y:?} {z:?} {u:?} {v:?} {w:?} {:?}", s.radius)
    };
    let rows: Vec<String> = surfels.iter().enumerate().map(row).collect();
    let plain = scene(1.0, origin);
    CaseScene { cloud: ply(&rows), ..plain }
}

fn doubles_far_away(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let right = engine.shade(&ply_scene(DVec3::ZERO, |_| 1.0))?;
    let found = engine.shade(&ply_scene(DVec3::new(1e7, -1e7, 1e7), |_| 1.0))?;
    Ok(difference(&found, &right, 1.0))
}

fn refused_row(engine: &mut dyn Engine, row: &str, said: &str) -> Result<f64, Refusal> {
    let good = "1 1 1 0 1 0 0.1".to_owned();
    let scene = CaseScene { cloud: ply(&[good, row.to_owned()]), ..scene(1.0, DVec3::ZERO) };
    refused(engine, &scene, 3, said)
}

/// Powers of two from 2⁻¹⁷ to 2¹⁷.
fn odd_length(index: usize) -> f64 {
    2f64.powi((index * 7 % 35) as i32 - 17)
}

fn odd_normals(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let right = engine.shade(&ply_scene(DVec3::ZERO, |_| 1.0))?;
    let found = engine.shade(&ply_scene(DVec3::ZERO, odd_length))?;
    Ok(difference(&found, &right, 1.0))
}

fn odd_receivers(engine: &mut dyn Engine) -> Result<f64, Refusal> {
    let right = engine.shade(&scene(1.0, DVec3::ZERO))?;
    let mut odd = scene(1.0, DVec3::ZERO);
    for (index, receiver) in odd.receivers.iter_mut().enumerate() {
        receiver.normal *= odd_length(index) as f32;
    }
    let found = engine.shade(&odd)?;
    Ok(difference(&found, &right, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_over_the_largest_result_of_their_kind() {
        let of = |surfaces: f64, open: f64| Found { surfaces, open, ..Found::default() };
        let right = [of(2.0, 0.5), of(100.0, 1.0)];
        assert_eq!(difference(&right, &right, 1.0), 0.0);
        assert_eq!(difference(&[of(2.0, 0.5), of(100.0, 0.75)], &right, 1.0), 0.25);
        assert_eq!(difference(&[of(4.0, 0.5), of(200.0, 1.0)], &right, 2.0), 0.0);
        assert_eq!(difference(&[right[0]; 2], &[right[0]; 2], 1.0), f64::INFINITY);
        assert_eq!(difference(&[of(f64::NAN, 0.5), right[1]], &right, 1.0), f64::INFINITY);
        assert_eq!(difference(&right[..1], &right, 1.0), f64::INFINITY);
    }
}
