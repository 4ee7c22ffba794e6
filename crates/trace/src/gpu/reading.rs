//! Buffers that the device fills and the host reads, and a pool to use them again.

use std::sync::mpsc;

use super::device::{Gpu, PATIENCE};
use super::tally::LISTS;
use crate::error::TracerError;

/// Read-back buffers that are not in flight.
#[derive(Default)]
pub(super) struct Spare(Vec<wgpu::Buffer>);

impl Spare {
    /// Returns a buffer of at least `bytes` bytes.
    pub(super) fn buffer(&mut self, device: &wgpu::Device, bytes: u64) -> wgpu::Buffer {
        match self.0.iter().position(|b| b.size() >= bytes) {
            Some(i) => self.0.swap_remove(i),
            None => device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("read-back"),
                size: bytes,
                usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
        }
    }
}

/// A buffer that the device fills.
pub(super) struct Reading {
    buffer: wgpu::Buffer,
    submission: wgpu::SubmissionIndex,
    mapped: mpsc::Receiver<Result<(), wgpu::BufferAsyncError>>,
}

impl Reading {
    /// Submits commands that fill `buffer`.
    pub(super) fn submit(
        gpu: &Gpu,
        encoder: wgpu::CommandEncoder,
        buffer: wgpu::Buffer,
    ) -> Result<Self, TracerError> {
        let submission = gpu.queue.submit([encoder.finish()]);
        let (sender, mapped) = mpsc::channel();
        // The receiver no longer exists if an earlier batch failed.
        buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            drop(sender.send(result))
        });
        gpu.check()?;
        Ok(Self {
            buffer,
            submission,
            mapped,
        })
    }

    /// Waits for the buffer and passes its words to `read`. The buffer may be longer than requested.
    pub(super) fn words<R>(
        self,
        gpu: &Gpu,
        spare: &mut Spare,
        read: impl FnOnce(&[u32]) -> Result<R, TracerError>,
    ) -> Result<R, TracerError> {
        gpu.wait(self.submission)?;
        match self.mapped.recv_timeout(PATIENCE) {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(gpu.failed(format!("reading cubes back: {error}"))),
            Err(_) => return Err(gpu.failed("a read-back buffer of cubes was not mapped")),
        }
        let result = {
            let view = self.buffer.get_mapped_range(..);
            let view = view.map_err(|e| gpu.failed(format!("reading cubes back: {e}")))?;
            read(bytemuck::cast_slice(&view))
        }?;
        self.buffer.unmap();
        if spare.0.len() < LISTS {
            spare.0.push(self.buffer);
        }
        Ok(result)
    }
}
