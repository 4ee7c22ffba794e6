//! What `sightline query --why` asks about: a triangle or an object.

/// How the number or name of an object begins where it could be taken for that of a triangle.
pub const OBJECT: &str = "object:";

/// What --why asks about.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum What {
    /// A triangle, by its number.
    Triangle(u32),
    /// An object, by its name or number.
    Object(String),
}

impl What {
    /// Reads the value of --why: digits are a triangle, all else an object.
    pub fn parse(text: &str) -> Result<Self, String> {
        match (text.strip_prefix(OBJECT).unwrap_or(text), text.parse()) {
            ("", _) => Err("give the number of a triangle or the name of an object".to_owned()),
            (_, Ok(triangle)) => Ok(Self::Triangle(triangle)),
            (object, Err(_)) => Ok(Self::Object(object.to_owned())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_are_a_triangle_and_all_else_an_object() {
        assert_eq!(What::parse("12"), Ok(What::Triangle(12)));
        assert_eq!(What::parse("object:12"), Ok(What::Object("12".to_owned())));
        assert_eq!(What::parse("door 3"), Ok(What::Object("door 3".to_owned())));
        assert!(What::parse("").is_err() && What::parse("object:").is_err());
    }
}
