//! Triangles on the device, in vertex buffers in drawing order.
//!
//! The module also has the triangle id of each slot, and the ranges of slots to draw for each face. A slot is
//! the place of a triangle in the drawing order.

use std::ops::Range;

use glam::Vec3;
use sightline_scene::{Aabb, Triangle};

use super::clusters::{CLUSTER, faces_touched};
use super::pipelines::scoped;

/// Size of a triangle in a vertex buffer, in bytes: three positions of three floats.
pub(super) const TRIANGLE_BYTES: u64 = 36;

/// The conversion of ranges of slots to draw calls. The style affects the speed and no pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct DrawStyle {
    /// The maximum number of slots between two ranges that are drawn as one range, with the slots between
    /// them.
    bridge: u32,
    /// The maximum number of slots in a draw call.
    longest: u32,
}

impl DrawStyle {
    /// The style for GPUs: a draw call costs more than a few clusters.
    pub(super) const HARDWARE: Self = Self {
        bridge: 4 * CLUSTER as u32,
        longest: u32::MAX,
    };

    /// The style for lavapipe: a draw call costs little. A single clipped triangle sends the whole call down
    /// a slow path, whose time grows with the square of the call's length (up to thousands of vertices). One
    /// cluster per call halves the time.
    pub(super) const SOFTWARE: Self = Self {
        bridge: 0,
        longest: CLUSTER as u32,
    };
}

/// The triangles on the device, shared by all renderers that draw them.
pub(super) struct Geometry {
    /// The triangle id of each slot.
    pub(super) ids: Vec<u32>,
    clusters: Vec<Aabb>,
    pages: Vec<wgpu::Buffer>,
    /// The number of slots in a page, a multiple of [`CLUSTER`]; the last page may have fewer.
    page_slots: u32,
    style: DrawStyle,
}

/// The ranges of slots of each face, ascending and disjoint.
pub(super) type Visible = [Vec<Range<u32>>; 6];

impl Geometry {
    /// Copies the triangles `ids` (in drawing order, all inside `triangles`) to the device.
    ///
    /// # Errors
    /// The device's message if it has not enough memory.
    pub(super) fn upload(
        device: &wgpu::Device,
        triangles: &[Triangle],
        ids: Vec<u32>,
        page_bytes: u64,
        style: DrawStyle,
    ) -> Result<Self, String> {
        let cluster_bytes = CLUSTER as u64 * TRIANGLE_BYTES;
        // At least one cluster, and few enough that vertex indices, three per slot, fit in 32 bits.
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

    /// Returns the number of slots. It fits in `u32`, because ids are unique `u32` numbers.
    pub(super) fn slots(&self) -> u32 {
        self.ids.len() as u32
    }

    /// Returns for each face the ranges of slots that may be visible from `eye`: whole clusters, joined if
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
                // The instance index passes the first slot of the page to the shader.
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
