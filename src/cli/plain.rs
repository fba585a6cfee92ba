//! Text from elsewhere, made fit to be shown.
//!
//! Purpose: a server's words cannot move the cursor, change colours, turn the writing round or hide what follows.
//! Invariant: what comes out are printable characters, on one line but for [`lines`]. Must not know: where the text came from.

use serde_json::Value;

/// The most characters of a message that are shown.
const MOST: usize = 2000;

/// `text` on one line, its control characters replaced, and no longer than is of use.
pub(crate) fn plain(text: &str) -> String {
    let mut line: String = text.trim().chars().take(MOST).map(shown).collect();
    if text.trim().chars().nth(MOST).is_some() {
        line.push('…');
    }
    line
}

/// `text` as it is, line by line, its control characters replaced.
pub(crate) fn lines(text: &str) -> String {
    text.chars().map(|c| if c == '\n' { c } else { shown(c) }).collect()
}

/// A report whose strings can be shown. Numbers, and the order of its keys, stay as they are.
pub(crate) fn plain_json(value: Value) -> Value {
    let clean = |text: String| if text.chars().any(hidden) { text.chars().map(shown).collect() } else { text };
    match value {
        Value::String(text) => Value::String(clean(text)),
        Value::Array(all) => Value::Array(all.into_iter().map(plain_json).collect()),
        Value::Object(all) => Value::Object(all.into_iter().map(|(k, v)| (clean(k), plain_json(v))).collect()),
        other => other,
    }
}

fn shown(c: char) -> char {
    match c {
        '\n' | '\r' | '\t' => ' ',
        c if hidden(c) => char::REPLACEMENT_CHARACTER,
        c => c,
    }
}

/// Characters that act on their surroundings or cannot be seen: control characters, directions of writing, joiners,
/// line separators, tags.
fn hidden(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}')
        || matches!(c, '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_acts_on_a_terminal() {
        assert_eq!(
            plain("\u{1b}[31mbad\u{7}\nline\t\u{202e}x\u{9b}"),
            "\u{fffd}[31mbad\u{fffd} line \u{fffd}x\u{fffd}"
        );
        assert_eq!(plain(" Größe 3 µm, χ 2 \n"), "Größe 3 µm, χ 2");
        let long = plain(&"x".repeat(5000));
        assert!(long.chars().count() == MOST + 1 && long.ends_with('…'));
    }

    #[test]
    fn lines_stay_lines() {
        assert_eq!(lines("a\n\tb\u{1b}[2J\rc\n"), "a\n b\u{fffd}[2J c\n");
    }

    #[test]
    fn a_report_keeps_all_but_such_characters() {
        let usual = serde_json::json!({"b": 1, "a": ["x", {"c": null}], "d": 0.5});
        assert_eq!(plain_json(usual.clone()).to_string(), usual.to_string());
        let odd = serde_json::json!({"\u{1b}k": ["\u{202e}v"]});
        assert_eq!(plain_json(odd), serde_json::json!({"\u{fffd}k": ["\u{fffd}v"]}));
    }
}
