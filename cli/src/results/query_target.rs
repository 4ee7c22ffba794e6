//! The target of `sightline query --why`: a triangle or an object.

use sightline::TriangleId;

/// The prefix of an object's number or name, which distinguishes it from the number of a triangle.
pub const OBJECT: &str = "object:";

/// The target of `--why`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum QueryTarget {
    /// A triangle with this number.
    Triangle(TriangleId),
    /// An object with this name or number.
    Object(String),
}

impl QueryTarget {
    /// Parses the value of `--why`. Digits are a triangle, any other text is an object.
    pub fn parse(text: &str) -> Result<Self, String> {
        match (text.strip_prefix(OBJECT).unwrap_or(text), text.parse()) {
            ("", _) => Err("give the number of a triangle or the name of an object".to_owned()),
            (_, Ok(triangle)) => Ok(Self::Triangle(TriangleId(triangle))),
            (object, Err(_)) => Ok(Self::Object(object.to_owned())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_are_triangle_and_other_text_is_object() {
        assert_eq!(
            QueryTarget::parse("12"),
            Ok(QueryTarget::Triangle(TriangleId(12)))
        );
        assert_eq!(
            QueryTarget::parse("object:12"),
            Ok(QueryTarget::Object("12".to_owned()))
        );
        assert_eq!(
            QueryTarget::parse("door 3"),
            Ok(QueryTarget::Object("door 3".to_owned()))
        );
        assert!(QueryTarget::parse("").is_err() && QueryTarget::parse("object:").is_err());
    }
}
