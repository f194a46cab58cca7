//! How surfels lie in temporary files: without what is the same for all of them.

use pbgi_cloud::Surfel;

/// Bytes of a surfel that always differ: position, radius, area, orientation.
const HEAD: usize = 24;
/// Bytes of the radiance.
const RADIANCE: std::ops::Range<usize> = 24..36;
/// Bytes of albedo and flags.
const REST: std::ops::Range<usize> = 36..44;

/// Which parts of surfels are stored, and what the other parts are. Lossless.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RecordForm {
    /// What the parts are that are the same for all.
    common: Surfel,
    is_empty: bool,
    stores_radiance: bool,
    stores_rest: bool,
}

impl RecordForm {
    /// The form of no surfels.
    pub fn none() -> Self {
        let common = Surfel::default();
        Self { common, is_empty: true, stores_radiance: false, stores_rest: false }
    }

    /// What all surfels share, and whether the form is that of none, stores radiance, stores the rest.
    pub fn to_parts(self) -> (Surfel, [bool; 3]) {
        (self.common, [self.is_empty, self.stores_radiance, self.stores_rest])
    }

    /// The inverse of [`Self::to_parts`].
    pub fn from_parts(common: Surfel, [is_empty, stores_radiance, stores_rest]: [bool; 3]) -> Self {
        Self { common, is_empty, stores_radiance, stores_rest }
    }

    /// Makes sure that the form holds these surfels, too.
    pub fn widen(&mut self, surfels: &[Surfel]) {
        let Some(first) = surfels.first() else { return };
        if self.is_empty {
            (self.common, self.is_empty) = (*first, false);
        }
        let common = bytes_of(&self.common);
        let differs = |part: std::ops::Range<usize>| {
            surfels.iter().any(|s| bytes_of(s)[part.clone()] != common[part.clone()])
        };
        self.stores_radiance = self.stores_radiance || differs(RADIANCE);
        self.stores_rest = self.stores_rest || differs(REST);
    }

    /// Bytes of a record.
    pub fn record_bytes(&self) -> usize {
        let mut bytes = HEAD;
        if self.stores_radiance {
            bytes += RADIANCE.len();
        }
        if self.stores_rest {
            bytes += REST.len();
        }
        bytes
    }

    /// Appends the records of surfels.
    pub fn encode(&self, surfels: &[Surfel], out: &mut Vec<u8>) {
        for surfel in surfels {
            let bytes = bytes_of(surfel);
            match (self.stores_radiance, self.stores_rest) {
                (true, true) => out.extend_from_slice(bytes),
                (true, false) => out.extend_from_slice(&bytes[..RADIANCE.end]),
                (false, true) => {
                    out.extend_from_slice(&bytes[..HEAD]);
                    out.extend_from_slice(&bytes[REST]);
                }
                (false, false) => out.extend_from_slice(&bytes[..HEAD]),
            }
        }
    }

    /// Appends the surfels of whole records.
    pub fn decode(&self, records: &[u8], out: &mut Vec<Surfel>) {
        out.extend(records.chunks_exact(self.record_bytes()).map(|record| {
            let mut surfel = self.common;
            let bytes = bytemuck::bytes_of_mut(&mut surfel);
            bytes[..HEAD].copy_from_slice(&record[..HEAD]);
            let mut at = HEAD;
            if self.stores_radiance {
                bytes[RADIANCE].copy_from_slice(&record[at..at + RADIANCE.len()]);
                at += RADIANCE.len();
            }
            if self.stores_rest {
                bytes[REST].copy_from_slice(&record[at..]);
            }
            surfel
        }));
    }
}

fn bytes_of(surfel: &Surfel) -> &[u8; size_of::<Surfel>()] {
    bytemuck::cast_ref(surfel)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_cloud::SurfelFlags;
    use pbgi_math::Vec3;

    #[test]
    fn every_form_gives_back_what_it_got() {
        let plain: Vec<Surfel> = (0..50)
            .map(|i| Surfel::new(Vec3::splat(i as f32), Vec3::X, 1.0 + i as f32, 2.0))
            .map(|s| s.with_albedo([0.5; 3]))
            .collect();
        let lit: Vec<Surfel> =
            plain.iter().map(|s| s.with_radiance([s.radius, 0.0, 1.0])).collect();
        let mixed: Vec<Surfel> =
            plain.iter().map(|s| s.with_albedo([s.radius / 64.0; 3])).collect();
        let mut flagged = lit.clone();
        flagged[49].flags = SurfelFlags::ISOTROPIC;
        for (surfels, bytes) in [(plain, 24), (lit, 36), (mixed, 32), (flagged, 44)] {
            let mut form = RecordForm::none();
            form.widen(&surfels[..20]);
            form.widen(&[]);
            form.widen(&surfels[20..]);
            assert_eq!(form.record_bytes(), bytes);
            let (mut records, mut decoded) = (Vec::new(), Vec::new());
            form.encode(&surfels, &mut records);
            assert_eq!(records.len(), 50 * bytes);
            form.decode(&records, &mut decoded);
            assert!(decoded == surfels);
        }
    }
}
