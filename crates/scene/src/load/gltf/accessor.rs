//! Accessors: typed elements in a buffer view, checked once so that reads of elements cannot fail.
//!
//! Elements are decoded at each use and not copied into arrays, because many primitives may share an
//! accessor, and a scene stores only triangles.

use super::buffers::Buffers;
use super::component::Component;
use super::draco::{DecodedAccessors, DecodedElements};
use super::json;
use super::source::{GltfContext, QUANTIZATION};
use super::sparse::Overlay;
use super::uses::{AccessorRole, AccessorUse};
use crate::SceneError;
use crate::load::limits::EXPORT_AGAIN;

/// An accessor whose type and range were checked.
pub(super) struct CheckedAccessor<'a> {
    /// The bytes from the first element on. `None` means that all elements are zero.
    base: Option<&'a [u8]>,
    /// The distance between the starts of two elements, in bytes.
    stride: usize,
    /// The size of an element, in bytes.
    size: usize,
    /// The number of elements.
    count: u64,
    component: Component,
    normalized: bool,
    sparse: Option<Overlay<'a>>,
}

impl<'a> CheckedAccessor<'a> {
    fn new(
        source: &GltfContext<'_>,
        root: &json::Root,
        buffers: &'a Buffers<'_>,
        used: AccessorUse,
    ) -> Result<Self, SceneError> {
        let a = &root.accessors[used.accessor];
        let label = format!("{}, accessor {}", used.by, used.accessor);
        let bad = |why: String| source.bad(label.as_str(), why);
        let Some(component) = Component::from_number(a.component_type) else {
            return Err(bad(format!(
                "the component type {} is unknown",
                a.component_type
            )));
        };
        check_type(source, root, &label, a, component, used.role)?;
        let size = component.size() * used.role.shape().1;
        let mut stride = size;
        let base = match a.buffer_view {
            None if a.count > buffers.size() => {
                return Err(bad(format!(
                    "the accessor has {} elements but no buffer view, and the file has only {} bytes",
                    a.count,
                    buffers.size()
                )));
            }
            None => None,
            Some(v) => {
                let bytes = buffers.view(source, root, v)?;
                // A compressed view has its stride in the extension, too. Some files have the stride only
                // there.
                let view = &root.buffer_views[v];
                let given = view
                    .byte_stride
                    .or(view.meshopt().map(|(_, m)| m.byte_stride));
                stride = given.filter(|s| *s != 0).unwrap_or(size);
                if stride < size {
                    return Err(bad(format!(
                        "the stride of the buffer view is {stride} bytes, but an element has {size} bytes"
                    )));
                }
                let end = match a.count {
                    0 => Some(a.byte_offset),
                    n => (n - 1)
                        .checked_mul(stride)
                        .and_then(|l| l.checked_add(size)?.checked_add(a.byte_offset)),
                };
                if end.is_none_or(|e| e > bytes.len() as u64) {
                    let reason = format!(
                        "{} elements from byte {} reach beyond buffer view {v} of {} bytes",
                        a.count,
                        a.byte_offset,
                        bytes.len()
                    );
                    return Err(bad(reason));
                }
                Some(&bytes[a.byte_offset as usize..])
            }
        };
        let sparse = match &a.sparse {
            None => None,
            Some(s) => Some(Overlay::new(
                source, root, buffers, &label, s, a.count, size,
            )?),
        };
        // With two or more elements, the stride is below the view's length. With fewer elements the stride is
        // not used.
        let stride = usize::try_from(stride).unwrap_or(0);
        Ok(Self {
            base,
            stride,
            size: size as usize,
            count: a.count,
            component,
            normalized: a.normalized,
            sparse,
        })
    }

    /// Creates an accessor of elements that were decoded from Draco data.
    fn decoded(elements: &'a DecodedElements, role: AccessorRole, normalized: bool) -> Self {
        let size = (elements.component.size() * role.shape().1) as usize;
        let (base, count, component) = (
            Some(elements.bytes.as_slice()),
            elements.count,
            elements.component,
        );
        Self {
            base,
            stride: size,
            size,
            count,
            component,
            normalized,
            sparse: None,
        }
    }

    /// Returns the number of elements.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    /// Returns the bytes of element `i`. The result is empty if all components of the element are zero
    /// because the accessor has no buffer view.
    fn element(&self, i: u64) -> &[u8] {
        if let Some(b) = self.sparse.as_ref().and_then(|s| s.get(i)) {
            return b;
        }
        let Some(base) = self.base else { return &[] };
        // `new` has checked the range for every i below the count.
        let at = i as usize * self.stride;
        base.get(at..at + self.size).unwrap_or_default()
    }

    /// Returns element `i` as a position, in the units of the mesh.
    pub(super) fn position(&self, i: u64) -> [f64; 3] {
        let b = self.element(i);
        if b.is_empty() {
            return [0.0; 3];
        }
        // Nearly all positions use this path.
        if let (Component::F32, Some(&xyz)) = (self.component, b.first_chunk::<12>()) {
            return bytemuck::cast::<_, [[u8; 4]; 3]>(xyz)
                .map(|c| f64::from(f32::from_le_bytes(c)));
        }
        [0, 1, 2].map(|c| self.component.number(b, c, self.normalized))
    }

    /// Returns element `i` as a quaternion x, y, z, w.
    pub(super) fn quaternion(&self, i: u64) -> [f64; 4] {
        let b = self.element(i);
        if b.is_empty() {
            return [0.0; 4];
        }
        [0, 1, 2, 3].map(|c| self.component.number(b, c, self.normalized))
    }

    /// Returns element `i` as texture coordinates.
    pub(super) fn coordinates(&self, i: u64) -> [f64; 2] {
        let b = self.element(i);
        if b.is_empty() {
            return [0.0; 2];
        }
        [0, 1].map(|c| self.component.number(b, c, self.normalized))
    }

    /// Returns the alpha of element `i`, which is a colour.
    pub(super) fn alpha(&self, i: u64) -> f64 {
        let b = self.element(i);
        if b.is_empty() {
            0.0
        } else {
            self.component.number(b, 3, self.normalized)
        }
    }

    /// Returns element `i` as an index.
    pub(super) fn index(&self, i: u64) -> u64 {
        self.component.unsigned(self.element(i))
    }

    /// Returns the index value that would mean primitive restart, which glTF forbids.
    pub(super) fn restart(&self) -> u64 {
        match self.component {
            Component::U8 => 0xff,
            Component::U16 => 0xffff,
            _ => 0xffff_ffff,
        }
    }
}

/// Rejects accessors whose type or component type the role does not allow.
fn check_type(
    source: &GltfContext<'_>,
    root: &json::Root,
    label: &str,
    a: &json::Accessor,
    component: Component,
    role: AccessorRole,
) -> Result<(), SceneError> {
    use Component::{F32, I8, I16, U8, U16, U32};
    let (shape, _) = role.shape();
    if a.shape != shape {
        let given: String = a.shape.chars().take(20).collect();
        return Err(source.bad(label, format!("the type is {given}, but must be {shape}")));
    }
    match (role, component) {
        (AccessorRole::Indices, U8 | U16 | U32) if !a.normalized => Ok(()),
        (AccessorRole::Indices, _) => {
            Err(source.bad(label, "indices must be unsigned integers, not normalised"))
        }
        (AccessorRole::Positions | AccessorRole::Offsets | AccessorRole::Rotations, F32) => Ok(()),
        (AccessorRole::Rotations, I8 | I16) if a.normalized => Ok(()),
        (AccessorRole::Offsets, _) => {
            Err(source.bad(label, "translations and scales of instances must be floats"))
        }
        (AccessorRole::Rotations, _) => Err(source.bad(
            label,
            "rotations of instances must be floats or normalised signed integers",
        )),
        (AccessorRole::Coordinates, F32 | I8 | U8 | I16 | U16) | (AccessorRole::Colors, F32) => {
            Ok(())
        }
        (AccessorRole::Colors, U8 | U16) if a.normalized => Ok(()),
        (AccessorRole::Coordinates, U32) => {
            Err(source.bad(label, "texture coordinates cannot be 32-bit integers"))
        }
        (AccessorRole::Colors, _) => Err(source.bad(
            label,
            "vertex colours must be floats or normalised unsigned integers",
        )),
        (AccessorRole::Positions, I8 | U8 | I16 | U16) => {
            let declared = root.extensions_used.iter().chain(&root.extensions_required);
            if declared.into_iter().any(|e| e == QUANTIZATION) {
                return Ok(());
            }
            let reason =
                format!("the positions are integers, but the file does not declare {QUANTIZATION}");
            Err(SceneError::bad(source.file, label, reason, EXPORT_AGAIN))
        }
        (AccessorRole::Positions, U32) => {
            Err(source.bad(label, "positions cannot be 32-bit integers"))
        }
    }
}

/// The accessors that the placed meshes need, by role and index.
pub(super) struct Accessors<'a> {
    by_role: [Vec<Option<CheckedAccessor<'a>>>; AccessorRole::COUNT],
    /// An accessor without elements.
    none: CheckedAccessor<'a>,
}

impl<'a> Accessors<'a> {
    /// Checks every accessor in `used`.
    pub(super) fn resolve(
        source: &GltfContext<'_>,
        root: &json::Root,
        buffers: &'a Buffers<'_>,
        decoded: &'a DecodedAccessors,
        used: &[AccessorUse],
    ) -> Result<Self, SceneError> {
        let slots = || root.accessors.iter().map(|_| None).collect::<Vec<_>>();
        let mut by_role: [_; AccessorRole::COUNT] = std::array::from_fn(|_| slots());
        for used in used {
            let accessor = match decoded.get(used.role, used.accessor) {
                None => CheckedAccessor::new(source, root, buffers, *used)?,
                Some(elements) => {
                    let a = &root.accessors[used.accessor];
                    let label = format!("{}, accessor {}", used.by, used.accessor);
                    check_type(source, root, &label, a, elements.component, used.role)?;
                    CheckedAccessor::decoded(elements, used.role, a.normalized)
                }
            };
            by_role[used.role as usize][used.accessor] = Some(accessor);
        }
        let none = CheckedAccessor {
            base: None,
            stride: 0,
            size: 0,
            count: 0,
            component: Component::U8,
            normalized: false,
            sparse: None,
        };
        Ok(Self { by_role, none })
    }

    /// Returns the accessor with index `number` in its role. The result has no elements if [`uses`] did not
    /// list the accessor.
    pub(super) fn get(&self, role: AccessorRole, number: usize) -> &CheckedAccessor<'a> {
        self.by_role[role as usize]
            .get(number)
            .and_then(Option::as_ref)
            .unwrap_or(&self.none)
    }
}
