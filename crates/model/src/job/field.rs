//! The conversion between values of a job and fields of a protobuf message.

use super::SpecError;

/// A value that a field of a message can have.
pub trait FieldValue: Copy {
    /// The type of the field in the message.
    type Wire;

    /// Reads the value of a field.
    ///
    /// # Errors
    /// [`SpecError`] if the value is outside its range or has no name.
    fn from_wire(wire: Self::Wire) -> Result<Self, SpecError>;

    /// Returns the value in the type of the field.
    fn to_wire(self) -> Self::Wire;
}
