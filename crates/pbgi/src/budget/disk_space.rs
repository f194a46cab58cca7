//! How much room on disk a bake needs.

use pbgi_cloud::Surfel;

/// Bytes a surfel of an octree usually takes, nodes included.
const OCTREE_SURFEL_BYTES: u64 = 20;

/// Octrees between passes of light there are at once, at most: the one that is read and the one that is written.
const PASS_OCTREES_MAX: u64 = 2;

/// What decides how much room a bake needs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DiskUse {
    pub surfels: u64,
    /// Whether memory holds all surfels, so that none goes to disk to be sorted.
    pub is_held: bool,
    /// Passes of light, the last of which writes the output.
    pub passes: u32,
    /// Whether what is sorted is kept until the bake is complete.
    pub resumes: bool,
}

/// Room a bake needs on disk, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DiskSpace {
    /// Most of temporary files at any moment: sorted surfels, and octrees between passes of light.
    pub temporary: u64,
    /// Of the output, about.
    pub output: u64,
    /// Of the temporary files that are still there when the output is complete.
    lasting: u64,
}

impl DiskSpace {
    pub fn new(bake: DiskUse) -> Self {
        let octree = bake.surfels.saturating_mul(OCTREE_SURFEL_BYTES);
        let surfel_bytes = if bake.is_held { 0 } else { size_of::<Surfel>() as u64 };
        let sorted = bake.surfels.saturating_mul(surfel_bytes);
        // Every pass of light reads the sorted surfels; without any, they are read once.
        let lasting = match bake.passes {
            0 if bake.resumes => sorted,
            0 => 0,
            _ => sorted.saturating_add(octree),
        };
        let octrees = octree.saturating_mul(u64::from(bake.passes).min(PASS_OCTREES_MAX));
        Self { temporary: sorted.saturating_add(octrees), output: octree, lasting }
    }

    /// Whether the disks have less room than is needed. `temporary_free` and `output_free` are the bytes free for temporary files and for the
    /// output; with `is_one_disk` they are the same bytes.
    pub fn exceeds(&self, temporary_free: u64, output_free: u64, is_one_disk: bool) -> bool {
        let at_the_end = if is_one_disk { self.lasting } else { 0 };
        temporary_free < self.temporary || output_free < self.output.saturating_add(at_the_end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn space(passes: u32, is_held: bool, resumes: bool) -> DiskSpace {
        DiskSpace::new(DiskUse { surfels: 1000, is_held, passes, resumes })
    }

    #[test]
    fn octrees_between_passes_take_room() {
        for (passes, octrees) in [(0, 0), (1, 20_000), (2, 40_000), (3, 40_000), (64, 40_000)] {
            assert_eq!(space(passes, false, false).temporary, 44_000 + octrees, "{passes}");
            assert_eq!(space(passes, true, false).temporary, octrees, "{passes}");
            assert_eq!(space(passes, true, false).output, 20_000);
        }
        let all = DiskUse { surfels: u64::MAX, is_held: false, passes: 2, resumes: true };
        assert_eq!(DiskSpace::new(all).temporary, u64::MAX);
    }

    #[test]
    fn what_is_left_at_the_end_lies_beside_the_output() {
        for (passes, resumes, lasting) in
            [(0, false, 0), (0, true, 44_000), (1, false, 64_000), (2, true, 64_000)]
        {
            let space = space(passes, false, resumes);
            let one_disk = (space.lasting + 20_000).max(space.temporary);
            assert_eq!(space.lasting, lasting, "{passes} {resumes}");
            assert!(!space.exceeds(one_disk, one_disk, true));
            assert!(space.exceeds(one_disk - 1, one_disk - 1, true));
            assert!(!space.exceeds(space.temporary, 20_000, false));
            assert!(space.exceeds(space.temporary - 1, 20_000, false));
            assert!(space.exceeds(space.temporary, 19_999, false));
        }
    }
}
