//! Text in HTML documents.

/// Escapes a text for an HTML document. Control characters, which a document may not hold, become U+FFFD;
/// line ends and tabs stay.
pub fn escaped(text: &str) -> String {
    let is_forbidden = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    text.replace(is_forbidden, "\u{fffd}")
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_ends_no_element_and_has_no_control_characters() {
        assert_eq!(escaped("<b>\"&"), "&lt;b&gt;&quot;&amp;");
        assert_eq!(
            escaped("a\u{1b}[31m\u{0}\u{85}\tb"),
            "a\u{fffd}[31m\u{fffd}\u{fffd}\tb"
        );
    }
}
