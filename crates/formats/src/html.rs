//! Escaping of text in HTML documents.

/// Escapes a text for an HTML document. Replaces control characters, which a document must not contain, by
/// U+FFFD. Keeps line ends and tabs.
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
    fn escaped_text_has_no_markup_and_no_control_characters() {
        assert_eq!(escaped("<b>\"&"), "&lt;b&gt;&quot;&amp;");
        assert_eq!(
            escaped("a\u{1b}[31m\u{0}\u{85}\tb"),
            "a\u{fffd}[31m\u{fffd}\u{fffd}\tb"
        );
    }
}
