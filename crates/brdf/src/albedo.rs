//! What a white rough surface reflects of uniform light at the first bounce.
//!
//! Microfacets with Smith's masking of both directions on their own lose what they reflect at each other: from 0 of smooth surfaces to 69 % of
//! roughness 1. That is put back by scaling the lobe (Turquin, *Practical multiple scattering compensation for microfacet models*, 2019), after
//! Kulla and Conty, *Revisiting physically based shading at Imageworks* (2017).

/// Rows of roughness and places between grazing and normal view.
const EDGE: usize = 16;

/// Least roughness of the table, which is that of [`crate::Material`].
const ROUGHNESS_MIN: f32 = 0.02;

/// Ten-thousandths that are reflected, by roughness √α from 0.02 to 1, and by μ(1 + α)/(μ + α) of the cosine μ from 0 to 1. The second goes with the
/// ratio of cosine and width, on which the albedo of narrow lobes depends.
const ALBEDO: [u16; EDGE * EDGE] = [
    9361, 9295, 9218, 9130, 9036, 8942, 8863, 8818, 8831, 8925, 9110, 9367, 9641, 9857, 9971,
    10000, 9361, 9296, 9219, 9132, 9038, 8945, 8866, 8819, 8829, 8917, 9095, 9347, 9620, 9841,
    9964, 10000, 9358, 9294, 9218, 9133, 9041, 8949, 8869, 8819, 8820, 8896, 9059, 9299, 9570,
    9804, 9946, 9993, 9346, 9283, 9208, 9125, 9035, 8944, 8863, 8808, 8799, 8857, 8997, 9216, 9480,
    9728, 9899, 9978, 9318, 9255, 9183, 9102, 9013, 8924, 8842, 8781, 8760, 8797, 8909, 9100, 9349,
    9607, 9813, 9929, 9264, 9202, 9130, 9051, 8964, 8876, 8792, 8725, 8690, 8704, 8785, 8941, 9164,
    9422, 9659, 9826, 9176, 9112, 9040, 8960, 8874, 8786, 8700, 8626, 8577, 8568, 8614, 8729, 8916,
    9157, 9413, 9633, 9043, 8976, 8901, 8819, 8732, 8641, 8552, 8470, 8407, 8374, 8386, 8456, 8595,
    8800, 9051, 9308, 8860, 8786, 8705, 8618, 8526, 8430, 8335, 8244, 8166, 8109, 8086, 8110, 8194,
    8344, 8559, 8819, 8620, 8536, 8446, 8350, 8250, 8146, 8041, 7939, 7844, 7763, 7706, 7684, 7708,
    7790, 7940, 8155, 8322, 8224, 8121, 8013, 7901, 7785, 7668, 7551, 7437, 7332, 7241, 7174, 7138,
    7147, 7211, 7341, 7968, 7853, 7733, 7609, 7481, 7350, 7217, 7082, 6948, 6818, 6696, 6586, 6496,
    6433, 6408, 6431, 7563, 7427, 7288, 7145, 6999, 6850, 6698, 6544, 6390, 6236, 6084, 5938, 5800,
    5676, 5572, 5495, 7115, 6957, 6796, 6633, 6467, 6298, 6127, 5954, 5779, 5604, 5427, 5252, 5079,
    4910, 4748, 4595, 6636, 6455, 6271, 6087, 5901, 5713, 5524, 5333, 5141, 4948, 4754, 4559, 4363,
    4168, 3973, 3778, 6137, 5932, 5728, 5523, 5319, 5114, 4910, 4705, 4501, 4296, 4091, 3887, 3682,
    3478, 3273, 3069,
];

/// Share of uniform light that a white surface with slopes of width `alpha`, 0.0004..=1, reflects at the first bounce toward an eye at
/// `cosine`, above 0.
///
/// Within 0.5 % of the integral at every width and angle (`tests::the_table_is_the_integral`).
#[inline]
pub fn first_bounce_albedo(alpha: f32, cosine: f32) -> f32 {
    let roughness = (alpha.sqrt() - ROUGHNESS_MIN) * (1.0 / (1.0 - ROUGHNESS_MIN));
    let view = cosine * (1.0 + alpha) / (cosine + alpha);
    let split = |x: f32| {
        let place = x.clamp(0.0, 1.0) * (EDGE - 1) as f32;
        let low = (place as usize).min(EDGE - 2);
        (low, place - low as f32)
    };
    let ((row, down), (column, right)) = (split(roughness), split(view));
    let along = |row: usize| {
        let [a, b] = [column, column + 1].map(|column| f32::from(ALBEDO[row * EDGE + column]));
        a + (b - a) * right
    };
    let (upper, lower) = (along(row), along(row + 1));
    (upper + (lower - upper) * down) * 1e-4
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{LN_2, TAU};

    /// Smith's share of microfacets that are not masked.
    fn smith(cosine: f64, a2: f64) -> f64 {
        2.0 * cosine / (cosine + (a2 + (1.0 - a2) * cosine * cosine).sqrt())
    }

    /// ∫ D G(o) G(d) / (4 n·o) dω over the microfacets' normals, dω = 4 (o·h) dω_h. D cos dω_h has the share u up to the slope α √(u/(1 − u)); rings
    /// are dense toward u = 1, where steep slopes are few and weigh much in slanting views.
    fn integral(alpha: f64, cosine: f64) -> f64 {
        let (rings, spokes) = (300, 300);
        let (sine, a2) = ((1.0 - cosine * cosine).sqrt(), alpha * alpha);
        let mut sum = 0.0;
        for ring in 0..rings {
            let rest = (f64::from(ring) + 0.5) / f64::from(rings);
            let (above, share) = (rest.powi(3), 3.0 * rest * rest);
            let cos = (1.0 / (1.0 + a2 * (1.0 - above) / above)).sqrt();
            let sin = (1.0 - cos * cos).sqrt();
            for spoke in 0..spokes {
                let phi = (f64::from(spoke) + 0.5) / f64::from(spokes) * TAU;
                let along = sine * sin * phi.cos() + cosine * cos;
                let height = 2.0 * along * cos - cosine;
                if along > 0.0 && height > 0.0 {
                    sum += share * smith(height, a2) * along / (cos * cosine);
                }
            }
        }
        sum * smith(cosine, a2) / f64::from(rings * spokes)
    }

    /// At every entry and between.
    #[test]
    fn the_table_is_the_integral() {
        let steps = 2 * (EDGE as i32 - 1);
        for i in 0..=steps {
            for j in 0..=steps {
                let share = |i: i32| f64::from(i) / f64::from(steps);
                let roughness =
                    f64::from(ROUGHNESS_MIN) + share(i) * f64::from(1.0 - ROUGHNESS_MIN);
                let (alpha, view) = (roughness * roughness, share(j));
                let cosine = (view * alpha / (1.0 + alpha - view)).clamp(1e-4, 1.0);
                let exact = integral(alpha, cosine);
                let found = f64::from(first_bounce_albedo(alpha as f32, cosine as f32));
                let error = found / exact - 1.0;
                assert!(error.abs() < 5e-3, "{roughness} {cosine}: {found}, {exact}");
            }
        }
    }

    /// Seen along the normal at roughness 1, D = 1/π and G(d) = cos 2θ/cos² θ: ∫ 2 sin θ cos 2θ/cos θ dθ up to 45° is 1 − ln 2.
    #[test]
    fn the_roughest_surface_reflects_one_less_the_logarithm_of_two() {
        let exact = 1.0 - LN_2;
        assert!((f64::from(first_bounce_albedo(1.0, 1.0)) - exact).abs() < 1e-4);
        assert!((integral(1.0, 1.0) - exact).abs() < 1e-4);
    }
}
