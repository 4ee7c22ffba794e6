//! Writes a `.pvs` of a synthetic world, to measure file size and look-up time without a bake.
//!
//! Usage: `synthetic_pvs city|forest CELLS_PER_AXIS RAYS_PER_CELL OUT.pvs`. The world is a grid of 256×256×32
//! blocks with two triangles for each face of a block. A city has houses and streets with only the exposed
//! faces. A forest has trees whose leaves are numbered in random order. A cell's set contains the triangles
//! that random rays from the cell hit first. So neighbouring cells have similar sets, and the sets have the
//! gaps of sampling. The program does not use code of the baker, so its results do not describe the baker.

#![allow(clippy::print_stdout, clippy::print_stderr)] // A program for people at a terminal.

use sightline_pvs::{Builder, CellTree, Header, Node, Object};

type AnyError = Box<dyn std::error::Error>;

const SIZE: [usize; 3] = [256, 256, 32];

/// A SplitMix64 random number generator (Steele et al. 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }
    fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 24) as f32
    }
    fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }
}

/// A grid of blocks. For each block, `object` contains its object's index, or 0 if the block is empty, and
/// `first` the first of the two triangles of each face.
struct World {
    object: Vec<u32>,
    first: Vec<[u32; 6]>,
    triangles: u32,
    objects: Vec<Object>,
}

fn at(p: [usize; 3]) -> usize {
    (p[2] * SIZE[1] + p[1]) * SIZE[0] + p[0]
}

fn world(forest: bool, random: &mut Random) -> World {
    let mut object = vec![0u32; SIZE.iter().product()];
    let mut blocks: Vec<Vec<[usize; 3]>> = vec![Vec::new()];
    let mut put = |blocks: &mut Vec<Vec<[usize; 3]>>, p: [usize; 3]| {
        if object[at(p)] == 0 {
            object[at(p)] = blocks.len() as u32;
            if let Some(last) = blocks.last_mut() {
                last.push(p);
            }
        }
    };
    for y in 0..SIZE[1] {
        for x in 0..SIZE[0] {
            put(&mut blocks, [x, y, 0]);
        }
    }
    let step = if forest { 12 } else { 16 };
    for by in (0..SIZE[1] - step).step_by(step) {
        for bx in (0..SIZE[0] - step).step_by(step) {
            blocks.push(Vec::new());
            if forest {
                let (cx, cy) = (bx + 4 + random.below(5), by + 4 + random.below(5));
                for z in 1..12 {
                    put(&mut blocks, [cx, cy, z]);
                }
                for _ in 0..700 {
                    let d = [random.below(11), random.below(11), random.below(11)];
                    if d.iter().map(|&c| (c as i32 - 5).pow(2)).sum::<i32>() < 27 {
                        put(
                            &mut blocks,
                            [(cx + d[0]).max(5) - 5, (cy + d[1]).max(5) - 5, 10 + d[2]],
                        );
                    }
                }
            } else {
                let height = 4 + random.below(20);
                for z in 1..height {
                    for y in by..by + step - 4 {
                        for x in bx..bx + step - 4 {
                            put(&mut blocks, [x, y, z]);
                        }
                    }
                }
            }
        }
    }
    let mut first = vec![[u32::MAX; 6]; object.len()];
    let (mut triangles, mut objects) = (0u32, Vec::new());
    for (i, list) in blocks.iter().enumerate() {
        let start = triangles;
        for face in 0..6 {
            for &p in list {
                let (axis, up) = (face / 2, face % 2 == 0);
                let mut q = p;
                q[axis] = if up {
                    q[axis] + 1
                } else {
                    q[axis].wrapping_sub(1)
                };
                let exposed = q[axis] >= SIZE[axis] || object[at(q)] == 0;
                // In a forest, the six faces of a block have consecutive ids. In a city, the faces of one
                // side of a house have consecutive ids.
                if exposed && !forest {
                    first[at(p)][face] = triangles;
                    triangles += 2;
                }
                if forest && face == 0 {
                    for f in &mut first[at(p)] {
                        *f = triangles;
                        triangles += 2;
                    }
                }
            }
        }
        objects.push(Object {
            name: format!("object {i}"),
            first: start,
            count: triangles - start,
            source: None,
        });
    }
    World {
        object,
        first,
        triangles,
        objects,
    }
}

impl World {
    /// Returns the first triangle that the ray from `p` along `d` hits. Traverses the blocks in order
    /// (Amanatides and Woo 1987).
    fn trace(&self, p: [f32; 3], d: [f32; 3]) -> Option<u32> {
        let mut cell = p.map(|c| c as usize);
        if self.object[at(cell)] != 0 {
            return None;
        }
        let mut t: [f32; 3] = std::array::from_fn(|a| {
            let edge = cell[a] as f32 + if d[a] > 0.0 { 1.0 } else { 0.0 };
            if d[a] == 0.0 {
                f32::INFINITY
            } else {
                (edge - p[a]) / d[a]
            }
        });
        loop {
            let a = if t[0] < t[1] && t[0] < t[2] {
                0
            } else {
                1 + usize::from(t[2] <= t[1])
            };
            cell[a] = if d[a] > 0.0 {
                cell[a] + 1
            } else {
                cell[a].wrapping_sub(1)
            };
            if cell[a] >= SIZE[a] {
                return None;
            }
            if self.object[at(cell)] != 0 {
                let hit: [f32; 3] = std::array::from_fn(|i| p[i] + t[a] * d[i] - cell[i] as f32);
                let half = u32::from(hit[(a + 1) % 3] > hit[(a + 2) % 3]);
                let face = a * 2 + usize::from(d[a] > 0.0);
                return Some(self.first[at(cell)][face].wrapping_add(half))
                    .filter(|&id| id < self.triangles);
            }
            t[a] += 1.0 / d[a].abs();
        }
    }
}

/// Writes a regular grid as a kd-tree, halving the axis with the most cells.
fn grid(bounds: [[f32; 3]; 2], cells: [usize; 3], nodes: &mut Vec<Node>) {
    let axis = (0..3).fold(0, |best, a| if cells[a] > cells[best] { a } else { best });
    if cells[axis] <= 1 {
        return nodes.push(Node::Leaf);
    }
    let below = cells[axis] / 2;
    let at =
        bounds[0][axis] + (bounds[1][axis] - bounds[0][axis]) * below as f32 / cells[axis] as f32;
    nodes.push(Node::Split {
        axis: axis as u8,
        at,
    });
    let (mut lower, mut upper) = ((bounds, cells), (bounds, cells));
    lower.0[1][axis] = at;
    lower.1[axis] = below;
    upper.0[0][axis] = at;
    upper.1[axis] = cells[axis] - below;
    grid(lower.0, lower.1, nodes);
    grid(upper.0, upper.1, nodes);
}

fn main() -> Result<(), AnyError> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [kind, cells, rays, out] = &args[..] else {
        return Err("usage: synthetic_pvs city|forest CELLS_PER_AXIS RAYS_PER_CELL OUT.pvs".into());
    };
    let (cells, rays): (usize, usize) = (cells.parse()?, rays.parse()?);
    let mut random = Random(1);
    let world = world(kind == "forest", &mut random);
    let view_box = [[0.0, 0.0, 1.0], [255.9, 255.9, 12.0]];
    let mut nodes = Vec::new();
    grid(view_box, [cells; 3], &mut nodes);
    let tree = CellTree::new(view_box, nodes)?;
    let mut builder = Builder::new(Header {
        triangles: world.triangles,
        method: "aggressive".into(),
        tree: tree.clone(),
        objects: world.objects.clone(),
        info_json: format!(r#"{{"world":"{kind}","rays_per_cell":{rays}}}"#),
    })?;
    let mut seen = vec![false; world.triangles as usize];
    for cell in 0..tree.cells() {
        let Some([lo, hi]) = tree.cell_bounds(cell) else {
            break;
        };
        seen.fill(false);
        for _ in 0..rays {
            let p = std::array::from_fn(|a| lo[a] + (hi[a] - lo[a]) * random.unit());
            let d: [f32; 3] = std::array::from_fn(|_| random.unit() * 2.0 - 1.0);
            if let Some(id) = world.trace(p, d) {
                seen[id as usize] = true;
            }
        }
        let ids: Vec<u32> = (0..world.triangles)
            .filter(|&id| seen[id as usize])
            .collect();
        builder.push_cell(&ids, &[], 0)?;
    }
    let mut file = std::io::BufWriter::new(std::fs::File::create(out)?);
    let stats = builder.finish(&mut file)?;
    println!(
        "{} triangles, {} cells, {stats:?}",
        world.triangles,
        tree.cells()
    );
    Ok(())
}
