//! The accessors that drawn geometry needs, and the modes of primitives.

use super::json;
use super::nodes::Draw;
use super::source::Source;
use crate::SceneError;

/// The uses of an accessor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    Positions = 0,
    Indices = 1,
}

/// The modes of a primitive (glTF 2.0, section 3.7.2.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    /// Points and lines of any kind: no surface.
    NoSurface,
    Triangles,
    Strip,
    Fan,
}

/// An accessor that drawn geometry needs, and where it is first needed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Use {
    pub(super) accessor: usize,
    pub(super) role: Role,
    pub(super) mesh: usize,
    pub(super) primitive: usize,
}

/// Every accessor that `draws` need, once for each role, in the order of meshes.
pub(super) fn uses(source: &Source<'_>, root: &json::Root, draws: &[Draw]) -> Result<Vec<Use>, SceneError> {
    let mut drawn = vec![false; root.meshes.len()];
    for d in draws {
        drawn[d.mesh] = true;
    }
    let mut met = [vec![false; root.accessors.len()], vec![false; root.accessors.len()]];
    let mut uses = Vec::new();
    for (mesh, m) in root.meshes.iter().enumerate().filter(|(m, _)| drawn[*m]) {
        for (primitive, p) in m.primitives.iter().enumerate() {
            let element = || format!("mesh {mesh}, primitive {primitive}");
            let Some(position) = surface(p).map_err(|why| source.bad(element(), why))? else { continue };
            for (role, a) in [(Role::Positions, Some(position)), (Role::Indices, p.indices)] {
                let Some(accessor) = a else { continue };
                match met[role as usize].get_mut(accessor) {
                    Some(met) if *met => {}
                    Some(met) => {
                        *met = true;
                        uses.push(Use { accessor, role, mesh, primitive });
                    }
                    None => {
                        let reason = format!("it names accessor {accessor} of {}", root.accessors.len());
                        return Err(source.bad(element(), reason));
                    }
                }
            }
        }
    }
    Ok(uses)
}

pub(super) fn mode(p: &json::Primitive) -> Result<Mode, String> {
    Ok(match p.mode.unwrap_or(4) {
        0..=3 => Mode::NoSurface,
        4 => Mode::Triangles,
        5 => Mode::Strip,
        6 => Mode::Fan,
        other => return Err(format!("its mode is {other}, and modes are 0 to 6")),
    })
}

/// The accessor of the positions, when the primitive has a surface at all.
pub(super) fn surface(p: &json::Primitive) -> Result<Option<usize>, String> {
    Ok(if mode(p)? == Mode::NoSurface { None } else { p.attributes.position })
}
