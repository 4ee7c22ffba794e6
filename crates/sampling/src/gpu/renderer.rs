//! Rendering a batch of cubes: several are in flight at once, each with a read-back buffer. While the device
//! draws a cube, the CPU culls and records the next one and reads the previous one.
//!
//! The number of triangles in a cube is known only after it is rendered. So the first part of the list is
//! read back, as long as earlier cubes needed; a cube with more triangles is rendered again with a longer
//! part.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, mpsc};

use glam::Vec3;

use super::device::{Gpu, MOST_DISTANT, PATIENCE};
use super::geometry::{Geometry, Visible};
use super::locks::lock;
use super::pipelines::{FACE_STRIDE, Kit, face_uniforms};
use super::tally::{ENTRY_BYTES, LIST_HEAD, Tally};
use crate::backend::CubeRenderer;
use crate::cube::{CubeImage, SKY, Strata};
use crate::error::BackendError;
use sightline_model::VisibilitySample;

/// Cubes in flight.
const RING: u64 = 4;
/// Most bytes of read-back buffers in flight; large buffers reduce the number of cubes in flight.
const RING_BYTES: u64 = 1 << 28;
/// Entries of the list that are read back for the first cube.
const FIRST_READ: u32 = 8192;
/// Pixels of a row that one invocation of the reduction reads, and the side of its workgroup; as in
/// `reduce.wgsl`.
const SEGMENT: u32 = 16;
const REDUCE_SIDE: u32 = 8;
/// Workgroups of the gathering pass; each goes through the list in strides.
const GATHER_GROUPS: u32 = 64;

/// (triangle id, strata mask, pixel count), in any order.
type Runs = Vec<(u32, u32, u32)>;

/// The number of triangles in a cube, and its wanted parts; `None` when the list was cut short.
type Landed = (u32, Option<(Runs, Option<Vec<u32>>)>);

/// Buffers for rendering cubes; used by one batch at a time.
#[derive(Default)]
pub(super) struct Work {
    tally: Option<Tally>,
    /// Entries of a list to read back; 0 before the first cube.
    entries: u32,
    /// Read-back buffers that are not in flight, all of `spare_bytes` bytes.
    spare: Vec<wgpu::Buffer>,
    spare_bytes: u64,
}

/// Which parts of a cube to read back.
#[derive(Clone, Copy)]
struct Want {
    list: bool,
    pixels: bool,
}

/// Offsets and sizes of the parts of a read-back buffer, in bytes.
#[derive(Clone, Copy)]
struct Layout {
    list_bytes: u64,
    pixels_at: u64,
    row_bytes: u32,
    bytes: u64,
}

/// A cube that was submitted to the device.
struct Flight {
    index: usize,
    buffer: wgpu::Buffer,
    submission: wgpu::SubmissionIndex,
    mapped: mpsc::Receiver<Result<(), wgpu::BufferAsyncError>>,
}

/// Renders the triangles of one [`Geometry`].
pub(super) struct GpuRenderer<'a> {
    gpu: &'a Gpu,
    kit: &'a Kit,
    /// The buffers of one batch, shared by all renderers of the device.
    work: &'a Mutex<Work>,
    geometry: Arc<Geometry>,
}

impl<'a> GpuRenderer<'a> {
    /// A renderer of `geometry`.
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device cannot make the pipelines.
    pub(super) fn new(
        gpu: &'a Gpu,
        work: &'a Mutex<Work>,
        geometry: Arc<Geometry>,
    ) -> Result<Self, BackendError> {
        Ok(Self { gpu, kit: gpu.kit()?, work, geometry })
    }

    fn pixels(&self) -> u32 {
        // At most 6 · 4096².
        6 * self.gpu.spec.resolution * self.gpu.spec.resolution
    }

    /// Renders a cube at each point and passes its wanted parts to `take`, in any order.
    fn render(
        &self,
        points: &[Vec3],
        want: Want,
        take: &mut dyn FnMut(usize, Runs, Option<Vec<u32>>),
    ) -> Result<(), BackendError> {
        self.gpu.check()?;
        for p in points {
            // Also refuses NaN.
            if !p.abs().cmple(Vec3::splat(MOST_DISTANT)).all() {
                return Err(self.gpu.failed(format!("a cube at {p} cannot be rendered")));
            }
        }
        if self.geometry.slots() == 0 {
            let sky = want.pixels.then(|| vec![SKY; self.pixels() as usize]);
            (0..points.len()).for_each(|i| take(i, Runs::new(), sky.clone()));
            return Ok(());
        }
        let mut work = lock(self.work);
        let result = self.render_all(&mut work, points, want, take);
        if result.is_err() {
            // Counts may not be zero, and buffers may still be mapped.
            *work = Work::default();
        }
        result
    }

    fn render_all(
        &self,
        work: &mut Work,
        points: &[Vec3],
        want: Want,
        take: &mut dyn FnMut(usize, Runs, Option<Vec<u32>>),
    ) -> Result<(), BackendError> {
        self.make_room(work)?;
        let mut todo: Vec<usize> = (0..points.len()).collect();
        while !todo.is_empty() {
            let layout = self.layout(work, want);
            if work.spare_bytes != layout.bytes {
                work.spare.clear();
                work.spare_bytes = layout.bytes;
            }
            let ring = (RING_BYTES / layout.bytes).clamp(1, RING) as usize;
            let mut again = Vec::new();
            let mut most = 0;
            let mut finish = |work: &mut Work, flight: Flight| -> Result<(), BackendError> {
                let index = flight.index;
                let (count, cube) = self.land(work, flight, layout, want)?;
                match cube {
                    Some((runs, pixels)) => take(index, runs, pixels),
                    None => again.push(index),
                }
                most = most.max(count);
                Ok(())
            };
            let mut flights = VecDeque::new();
            for index in todo {
                if flights.len() == ring
                    && let Some(oldest) = flights.pop_front()
                {
                    finish(work, oldest)?;
                }
                flights.push_back(self.launch(work, index, points[index], layout, want)?);
            }
            for flight in flights {
                finish(work, flight)?;
            }
            let capacity = work.tally.as_ref().map_or(0, |t| t.capacity);
            if most > work.entries {
                // A quarter more than needed, so that nearby cubes fit, too.
                work.entries =
                    most.saturating_add(most / 4).checked_next_power_of_two().unwrap_or(most).min(capacity);
            }
            todo = again;
        }
        Ok(())
    }

    /// Makes buffers for this geometry's slots, if they are missing, and sets the reduction's parameters.
    fn make_room(&self, work: &mut Work) -> Result<(), BackendError> {
        let b = self.gpu;
        if work.tally.as_ref().is_none_or(|t| t.slots < self.geometry.slots()) {
            // The old buffers are freed first, since there may not be room for both.
            work.tally = None;
            let tally = Tally::new(&b.device, self.kit, self.geometry.slots(), self.pixels());
            work.tally = Some(tally.map_err(|reason| b.failed(reason))?);
        }
        let capacity = work.tally.as_ref().map_or(0, |t| t.capacity);
        work.entries = work.entries.max(FIRST_READ).min(capacity);
        let strata = match b.spec.strata {
            Strata::One => 0,
            Strata::Faces => 1,
            Strata::Quadrants => 2,
        };
        b.queue.write_buffer(
            &self.kit.params,
            0,
            bytemuck::bytes_of(&[b.spec.resolution, capacity, strata, 0u32]),
        );
        Ok(())
    }

    fn layout(&self, work: &Work, want: Want) -> Layout {
        let n = self.gpu.spec.resolution;
        let list_bytes = if want.list { LIST_HEAD + u64::from(work.entries) * ENTRY_BYTES } else { 0 };
        let row_bytes = (3 * n * 4).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let pixels_at = list_bytes.next_multiple_of(u64::from(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT));
        let pixel_bytes = if want.pixels { u64::from(row_bytes) * u64::from(2 * n) } else { 0 };
        Layout { list_bytes, pixels_at, row_bytes, bytes: pixels_at + pixel_bytes }
    }

    /// Records and submits one cube.
    fn launch(
        &self,
        work: &mut Work,
        index: usize,
        eye: Vec3,
        layout: Layout,
        want: Want,
    ) -> Result<Flight, BackendError> {
        let b = self.gpu;
        let buffer = work.spare.pop().unwrap_or_else(|| {
            b.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("read-back"),
                size: layout.bytes,
                usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        });
        b.queue.write_buffer(&self.kit.faces, 0, &face_uniforms(eye, b.near));
        let mut encoder = b.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.record_faces(&mut encoder, &self.geometry.visible(eye));
        if want.list
            && let Some(tally) = &work.tally
        {
            self.record_reduction(&mut encoder, tally);
            encoder.copy_buffer_to_buffer(&tally.list, 0, &buffer, 0, layout.list_bytes);
        }
        if want.pixels {
            let size = self.kit.items.size();
            encoder.copy_texture_to_buffer(
                self.kit.items.as_image_copy(),
                wgpu::TexelCopyBufferInfo {
                    buffer: &buffer,
                    layout: wgpu::TexelCopyBufferLayout {
                        offset: layout.pixels_at,
                        bytes_per_row: Some(layout.row_bytes),
                        rows_per_image: None,
                    },
                },
                size,
            );
        }
        let submission = b.queue.submit([encoder.finish()]);
        let (sender, mapped) = mpsc::channel();
        // The receiver is gone when an earlier cube failed.
        buffer.map_async(wgpu::MapMode::Read, .., move |result| drop(sender.send(result)));
        self.gpu.check()?;
        Ok(Flight { index, buffer, submission, mapped })
    }

    fn record_faces(&self, encoder: &mut wgpu::CommandEncoder, visible: &Visible) {
        let kit = self.kit;
        let n = self.gpu.spec.resolution;
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("cube"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &kit.items_view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &kit.depth_view,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_pipeline(&kit.raster);
        for (face, ranges) in (0u32..).zip(visible) {
            if ranges.is_empty() {
                continue;
            }
            let (x, y) = ((face % 3) * n, (face / 3) * n);
            pass.set_bind_group(0, &kit.faces_group, &[face * FACE_STRIDE as u32]);
            pass.set_viewport(x as f32, y as f32, n as f32, n as f32, 0.0, 1.0);
            pass.set_scissor_rect(x, y, n, n);
            self.geometry.draw(&mut pass, ranges);
        }
    }

    fn record_reduction(&self, encoder: &mut wgpu::CommandEncoder, tally: &Tally) {
        let kit = self.kit;
        let n = self.gpu.spec.resolution;
        encoder.clear_buffer(&tally.list, 0, Some(LIST_HEAD));
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_bind_group(0, &tally.group, &[]);
        pass.set_pipeline(&kit.reduce);
        pass.dispatch_workgroups(n.div_ceil(SEGMENT * REDUCE_SIDE), (6 * n).div_ceil(REDUCE_SIDE), 1);
        pass.set_pipeline(&kit.gather);
        pass.dispatch_workgroups(GATHER_GROUPS, 1, 1);
    }

    /// Waits for a cube and reads its parts.
    fn land(
        &self,
        work: &mut Work,
        flight: Flight,
        layout: Layout,
        want: Want,
    ) -> Result<Landed, BackendError> {
        let b = self.gpu;
        b.wait(flight.submission)?;
        match flight.mapped.recv_timeout(PATIENCE) {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(b.failed(format!("reading a cube back: {error}"))),
            Err(_) => return Err(b.failed("a cube's read-back buffer was not mapped")),
        }
        let read = {
            let view = flight
                .buffer
                .get_mapped_range(..)
                .map_err(|e| b.failed(format!("reading a cube back: {e}")))?;
            self.read(&view, work, layout, want)
        };
        flight.buffer.unmap();
        work.spare.push(flight.buffer);
        read
    }

    fn read(&self, bytes: &[u8], work: &Work, layout: Layout, want: Want) -> Result<Landed, BackendError> {
        let words: &[u32] = bytemuck::cast_slice(bytes);
        let mut count = 0;
        let mut runs = Runs::new();
        if want.list {
            count = words[0];
            let capacity = work.tally.as_ref().map_or(0, |t| t.capacity);
            if count > capacity {
                return Err(self.gpu.failed(format!(
                    "a cube shows {count} triangles, more than the {capacity} the device can list; \
                     lower the resolution or use --backend cpu"
                )));
            }
            // `entries` changes only after all flights of a layout have landed, so the layout has this
            // length.
            if count > work.entries {
                return Ok((count, None));
            }
            let entries = &words[(LIST_HEAD / 4) as usize..][..3 * count as usize];
            runs.reserve_exact(count as usize);
            for e in entries.chunks_exact(3) {
                let id = self.geometry.ids.get(e[0] as usize).ok_or_else(|| self.stray(e[0]))?;
                runs.push((*id, e[1], e[2]));
            }
        }
        let pixels = match want.pixels {
            true => Some(self.faces_of(&words[(layout.pixels_at / 4) as usize..], layout.row_bytes)?),
            false => None,
        };
        Ok((count, Some((runs, pixels))))
    }

    /// Triangle ids from the pixels of the atlas, in the order of [`CubeImage`].
    fn faces_of(&self, atlas: &[u32], row_bytes: u32) -> Result<Vec<u32>, BackendError> {
        let (n, pitch) = (self.gpu.spec.resolution as usize, row_bytes as usize / 4);
        let mut ids = Vec::with_capacity(self.pixels() as usize);
        for row in 0..6 * n {
            let (face, y) = (row / n, row % n);
            let start = ((face / 3) * n + y) * pitch + (face % 3) * n;
            for item in &atlas[start..start + n] {
                ids.push(match item.checked_sub(1) {
                    None => SKY,
                    Some(slot) => *self.geometry.ids.get(slot as usize).ok_or_else(|| self.stray(slot))?,
                });
            }
        }
        Ok(ids)
    }

    fn stray(&self, slot: u32) -> BackendError {
        self.gpu.failed(format!("it saw triangle {slot} of {} drawn", self.geometry.slots()))
    }
}

impl CubeRenderer for GpuRenderer<'_> {
    fn samples(&self, points: &[Vec3]) -> Result<Vec<VisibilitySample>, BackendError> {
        let mut samples = vec![VisibilitySample::default(); points.len()];
        let want = Want { list: true, pixels: self.gpu.spec.keep_pixels };
        self.render(points, want, &mut |index, runs, pixels| {
            samples[index] =
                VisibilitySample { pixels: pixels.map(Into::into), ..VisibilitySample::from_runs(runs) };
        })?;
        Ok(samples)
    }

    fn image(&self, point: Vec3) -> Result<CubeImage, BackendError> {
        let mut ids = Vec::new();
        self.render(&[point], Want { list: false, pixels: true }, &mut |_, _, pixels| {
            ids = pixels.unwrap_or_default();
        })?;
        Ok(CubeImage { resolution: self.gpu.spec.resolution, ids })
    }
}
