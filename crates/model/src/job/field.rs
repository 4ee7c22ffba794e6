//! The values of a message's fields.

use super::SpecError;

/// A value that a field of a message can have.
pub trait FieldValue: Copy {
    /// The field's type.
    type Wire;

    /// Reads the field.
    ///
    /// # Errors
    /// [`SpecError`] for a value outside the range or without a name.
    fn from_wire(wire: Self::Wire) -> Result<Self, SpecError>;

    /// Returns the field.
    fn to_wire(self) -> Self::Wire;
}
