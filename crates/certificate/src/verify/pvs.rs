//! The implementation of [`BakedResult`] for `.pvs` files.

use glam::Vec3;
use sightline_numbers::Aabb;
use sightline_pvs::{Pvs, PvsError};

use super::BakedResult;

fn message(e: PvsError) -> String {
    e.to_string()
}

impl BakedResult for Pvs {
    fn method(&self) -> &str {
        self.method()
    }

    fn parameters(&self) -> &str {
        self.info_json()
    }

    fn cell_count(&self) -> u32 {
        self.cells()
    }

    fn triangle_count(&self) -> u32 {
        self.triangle_count()
    }

    fn cell_bounds(&self, cell: u32) -> Option<Aabb> {
        let [min, max] = self.cell_bounds(cell)?.map(Vec3::from);
        Some(Aabb { min, max })
    }

    fn visible(&self, cell: u32) -> Result<Vec<u32>, String> {
        let mut ids = Vec::new();
        self.visible(cell, &mut ids).map_err(message)?;
        Ok(ids)
    }

    fn undecided(&self, cell: u32) -> Result<Vec<u32>, String> {
        let mut ids = Vec::new();
        self.undecided(cell, &mut ids).map_err(message)?;
        Ok(ids)
    }

    fn certificate(&self, cell: u32) -> Result<Option<&[u8]>, String> {
        self.certificate(cell).map_err(message)
    }

    fn seen_cells(&self, cell: u32) -> Result<Option<Vec<u32>>, String> {
        let pairs = self.cell_pairs().map_err(message)?;
        Ok(pairs
            .filter(|_| cell < self.cells())
            .map(|p| p.visible.partners(cell).collect()))
    }

    fn flags(&self, cell: u32) -> Result<u32, String> {
        self.flags(cell).map_err(message)
    }
}
