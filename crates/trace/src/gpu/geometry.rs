//! Triangles on the device: vertex buffers in drawing order, the triangle id of each slot, and the ranges of
//! slots to draw for each face. A slot is the place of a triangle in the drawing order.

use std::ops::Range;

use glam::Vec3;
use sightline_scene::{Aabb, Triangle};

use super::clusters::{CLUSTER, faces_touched};
use super::pipelines::scoped;

/// Bytes of a triangle in a vertex buffer: three positions of three floats.
pub(super) const TRIANGLE_BYTES: u64 = 36;

/// How ranges of slots become draw calls. The style changes the speed and no pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct DrawStyle {
    /// Two ranges with at most this many slots between them are drawn as one, with the slots between.
    bridge: u32,
    /// Most slots in a draw call.
    longest: u32,
}

impl DrawStyle {
    /// For GPUs: a draw call costs more than a few clusters.
    pub(super) const HARDWARE: Self = Self {
        bridge: 4 * CLUSTER as u32,
        longest: u32::MAX,
    };

    /// For lavapipe: a draw call costs little, but a single clipped triangle sends the whole call down a slow
    /// path, whose time grows with the square of the call's length (up to some thousand vertices). One
    /// cluster for each call halves the time.
    pub(super) const SOFTWARE: Self = Self {
        bridge: 0,
        longest: CLUSTER as u32,
    };
}

/// Triangles on the device, shared by all renderers that draw them.
pub(super) struct Geometry {
    /// Triangle id of each slot.
    pub(super) ids: Vec<u32>,
    clusters: Vec<Aabb>,
    pages: Vec<wgpu::Buffer>,
    /// Slots in a page, a multiple of [`CLUSTER`]; the last page may hold fewer.
    page_slots: u32,
    style: DrawStyle,
}

/// For each face, ascending disjoint ranges of slots.
pub(super) type Visible = [Vec<Range<u32>>; 6];

impl Geometry {
    /// Copies the triangles named by `ids` (in drawing order, all inside `triangles`) to the device.
    ///
    /// # Errors
    /// What the device says when it has no room.
    pub(super) fn upload(
        device: &wgpu::Device,
        triangles: &[Triangle],
        ids: Vec<u32>,
        page_bytes: u64,
        style: DrawStyle,
    ) -> Result<Self, String> {
        let cluster_bytes = CLUSTER as u64 * TRIANGLE_BYTES;
        // At least one cluster; few enough that vertex indices, three for each slot, fit in 32 bits.
        let page_clusters = (page_bytes / cluster_bytes).clamp(1, (1 << 30) / CLUSTER as u64);
        let page_slots = page_clusters as u32 * CLUSTER as u32;
        let clusters = ids
            .chunks(CLUSTER)
            .map(|run| {
                run.iter().fold(Aabb::EMPTY, |b, id| {
                    b.union(triangles[*id as usize].bounds())
                })
            })
            .collect();
        let pages = scoped(device, || {
            ids.chunks(page_slots as usize)
                .map(|page| upload_page(device, triangles, page))
                .collect()
        })?;
        Ok(Self {
            clusters,
            pages,
            page_slots,
            ids,
            style,
        })
    }

    /// Number of slots. It fits in `u32`, since ids are unique `u32`.
    pub(super) fn slots(&self) -> u32 {
        self.ids.len() as u32
    }

    /// For each face, the ranges of slots that may be visible from `eye`: whole clusters, joined where
    /// [`DrawStyle::bridge`] allows.
    pub(super) fn visible(&self, eye: Vec3) -> Visible {
        let mut visible = Visible::default();
        let mut first = 0;
        for bounds in &self.clusters {
            let end = (first + CLUSTER as u32).min(self.slots());
            let mut faces = faces_touched(bounds, eye);
            while faces != 0 {
                let ranges = &mut visible[faces.trailing_zeros() as usize];
                match ranges.last_mut() {
                    Some(last) if first - last.end <= self.style.bridge => last.end = end,
                    _ => ranges.push(first..end),
                }
                faces &= faces - 1;
            }
            first = end;
        }
        visible
    }

    /// Draws `ranges` in order. The pipeline and the face's bindings must be set.
    pub(super) fn draw(&self, pass: &mut wgpu::RenderPass<'_>, ranges: &[Range<u32>]) {
        let mut bound = None;
        for range in ranges {
            let mut start = range.start;
            while start < range.end {
                let page = start / self.page_slots;
                let base = page * self.page_slots;
                let page_end = base.saturating_add(self.page_slots);
                let end = range
                    .end
                    .min(page_end)
                    .min(start.saturating_add(self.style.longest));
                if bound != Some(page) {
                    pass.set_vertex_buffer(0, self.pages[page as usize].slice(..));
                    bound = Some(page);
                }
                // The instance index tells the shader the first slot of the page.
                pass.draw((start - base) * 3..(end - base) * 3, base..base + 1);
                start = end;
            }
        }
    }
}

fn upload_page(
    device: &wgpu::Device,
    triangles: &[Triangle],
    page: &[u32],
) -> Result<wgpu::Buffer, String> {
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("triangles"),
        size: page.len() as u64 * TRIANGLE_BYTES,
        usage: wgpu::BufferUsages::VERTEX,
        mapped_at_creation: true,
    });
    {
        let mut view = buffer.get_mapped_range_mut(..).map_err(|e| e.to_string())?;
        let mut run = Vec::with_capacity(CLUSTER);
        let mut at = 0;
        for ids in page.chunks(CLUSTER) {
            run.clear();
            run.extend(ids.iter().map(|id| triangles[*id as usize]));
            let bytes: &[u8] = bytemuck::cast_slice(&run);
            view.slice(at..at + bytes.len()).copy_from_slice(bytes);
            at += bytes.len();
        }
    }
    buffer.unmap();
    Ok(buffer)
}
