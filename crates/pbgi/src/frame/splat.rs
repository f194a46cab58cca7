//! What a camera sees of an octree's own surfels, for files without a mesh.

use crate::PbgiError;
use crate::frame::band::{Band, Piece};
use pbgi_format::LeafSurfel;
use pbgi_gather::Material;
use pbgi_math::Vec3;
use pbgi_scene::{CameraView, Disk, HideOptions, VisibleSurfels, hide_disks};
use pbgi_store::{Octree, try_for_each_leaf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;

/// Surfels drawn at once. Up to four chunks of them are on their way, 1.3 MiB.
const CHUNK_SURFELS: usize = 1 << 13;

/// Albedo shown where a file has none: that of plaster, and of materials without a color.
const GRAY_ALBEDO: [f32; 3] = [0.8; 3];

/// Draws the surfels of `octree` as disks, streaming over its leaves, and returns those that are seen.
/// A second pass over the leaves fetches them.
///
/// # Errors
///
/// If the camera or an option is out of range, a page cannot be read, or on cancellation.
pub(crate) fn hide_surfels(
    octree: &Octree,
    view: &CameraView,
    options: &HideOptions,
    up: Vec3,
    cancel: &AtomicBool,
) -> Result<Band, PbgiError> {
    let visible = draw_disks(octree, view, options, cancel)?;
    let has_albedo = octree.header().flags.albedo;
    let mut pieces = Vec::with_capacity(visible.ids.len());
    try_for_each_leaf(&mut octree.reader(), |first, surfels| {
        if cancel.load(Ordering::Relaxed) {
            return Err(PbgiError::Interrupted);
        }
        // Ids rise as the walk does.
        while let Some(id) = visible.ids.get(pieces.len()) {
            let Some(surfel) = surfels.get((id - first) as usize) else { break };
            pieces.push(piece_of_surfel(surfel, view.eye(), up, has_albedo));
        }
        Ok(())
    })?;
    Ok(Band { pieces, ids: visible.ids, coverage: visible.coverage })
}

/// Walks the leaves on a thread of its own, a chunk ahead of the drawing.
fn draw_disks(
    octree: &Octree,
    view: &CameraView,
    options: &HideOptions,
    cancel: &AtomicBool,
) -> Result<VisibleSurfels, PbgiError> {
    let (sender, chunks) = sync_channel::<Vec<Disk>>(1);
    std::thread::scope(|scope| {
        let walk = scope.spawn(move || {
            let frustum = view.frustum();
            let mut chunk = Vec::with_capacity(CHUNK_SURFELS);
            // A receiver that is gone has found its own error.
            let send = |chunk: Vec<Disk>| sender.send(chunk).map_err(|_| PbgiError::Interrupted);
            try_for_each_leaf(&mut octree.reader(), |first, surfels| {
                if cancel.load(Ordering::Relaxed) {
                    return Err(PbgiError::Interrupted);
                }
                for (i, surfel) in surfels.iter().enumerate() {
                    if frustum.touches_sphere(surfel.center, surfel.radius) {
                        chunk.push(disk_of_surfel(first + i as u64, surfel));
                    }
                }
                if chunk.len() + 256 > CHUNK_SURFELS {
                    send(std::mem::replace(&mut chunk, Vec::with_capacity(CHUNK_SURFELS)))?;
                }
                Ok(())
            })?;
            send(chunk)
        });
        let visible = hide_disks(view, options, chunks);
        let walked = walk.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        let visible = visible?;
        walked.map(|()| visible)
    })
}

fn disk_of_surfel(id: u64, surfel: &LeafSurfel) -> Disk {
    Disk {
        id,
        center: surfel.center,
        normal: surfel.normal,
        radius: surfel.radius,
        isotropic: surfel.isotropic,
        front_only: surfel.front_only,
    }
}

/// The surfel as its camera sees it: turned to the side that is seen, or shaded as if it looked up
/// where it has no normal.
///
/// A surfel that reflects does not tell its emission from what it reflects, so only black ones shine.
/// Where the file stores no albedo all are light gray, and shine.
fn piece_of_surfel(surfel: &LeafSurfel, eye: Vec3, up: Vec3, has_albedo: bool) -> Piece {
    let toward_eye = (eye - surfel.center).normalize_or(up);
    let sees_front = surfel.normal.dot(toward_eye) >= 0.0;
    let facing = if sees_front { surfel.normal } else { -surfel.normal };
    let albedo = if has_albedo { surfel.albedo } else { GRAY_ALBEDO };
    Piece {
        position: surfel.center,
        normal: if surfel.isotropic { up } else { facing },
        plane: if surfel.isotropic { toward_eye } else { facing },
        radius: surfel.radius,
        albedo,
        material: Material { base_color: albedo, ..Material::default() },
        emission: if surfel.albedo == [0.0; 3] { surfel.radiance } else { [0.0; 3] },
        is_back: !surfel.isotropic && !sees_front,
    }
}
