//! Composition of WGSL.
//!
//! Purpose: [`compose`] turns a file with directives into plain WGSL. The first word of a line makes it a directive:
//!
//! | directive | meaning |
//! | --- | --- |
//! | `#import shared/name` | that file here, once per stage |
//! | `#repeat K in A..B` ... `#end` | the lines for each K: static unrolling |
//! | `#if E` ... `#end` | the lines if E is not 0 |
//!
//! In other lines, `$NAME` and `$(E)` stand for integers. E is made of integers, names, `+ - * % <` and parentheses. Names
//! are constants of the stage and variables of `#repeat`.
//!
//! Invariant: the same stage and constants give the same text. Must not know: the device, what a stage computes.

use std::collections::BTreeSet;

/// A stage could not be composed. Only a mistake in `shaders/` can cause it; tests compose all.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("shader {file}, line {line}: {what}")]
pub struct ComposeError {
    /// Name as in `#import`.
    pub file: String,
    /// Line, from 1.
    pub line: usize,
    /// What is wrong.
    pub what: String,
}

/// Files that stages are composed of: name and text.
pub type Sources = &'static [(&'static str, &'static str)];

/// A name and its value.
pub type Constant<'a> = (&'a str, i64);

/// Composes stage `name` of `sources` with `constants`.
pub fn compose(sources: Sources, name: &str, constants: &[Constant<'_>]) -> Result<String, ComposeError> {
    let mut composer = Composer {
        sources,
        out: String::new(),
        imported: BTreeSet::new(),
        scope: constants.iter().map(|(n, v)| ((*n).to_owned(), *v)).collect(),
    };
    composer.file(name, name, 1)?;
    Ok(composer.out)
}

struct Composer {
    sources: Sources,
    out: String,
    imported: BTreeSet<String>,
    scope: Vec<(String, i64)>,
}

struct Lines<'a> {
    file: &'a str,
    lines: Vec<&'a str>,
}

impl Lines<'_> {
    fn error<T>(&self, at: usize, what: impl Into<String>) -> Result<T, ComposeError> {
        Err(ComposeError { file: self.file.to_owned(), line: at + 1, what: what.into() })
    }

    /// The line of the `#end` that closes the block opened at `at`.
    fn end_of(&self, at: usize) -> Result<usize, ComposeError> {
        let mut depth = 0;
        for (k, line) in self.lines.iter().enumerate().skip(at) {
            match line.split_whitespace().next() {
                Some("#repeat" | "#if") => depth += 1,
                Some("#end") => depth -= 1,
                _ => {}
            }
            if depth == 0 {
                return Ok(k);
            }
        }
        self.error(at, "no #end")
    }
}

impl Composer {
    fn file(&mut self, name: &str, from: &str, line: usize) -> Result<(), ComposeError> {
        let Some((name, text)) = self.sources.iter().find(|(n, _)| *n == name) else {
            return Err(ComposeError { file: from.to_owned(), line, what: format!("no file {name:?}") });
        };
        if !self.imported.insert((*name).to_owned()) {
            return Ok(());
        }
        let lines = Lines { file: name, lines: text.lines().collect() };
        let end = lines.lines.len();
        self.lines(&lines, 0, end)
    }

    fn lines(&mut self, source: &Lines<'_>, begin: usize, end: usize) -> Result<(), ComposeError> {
        let mut at = begin;
        while at < end {
            let line = source.lines[at];
            let mut words = line.split_whitespace();
            match words.next() {
                Some("#import") => match words.next() {
                    Some(name) => self.file(name, source.file, at + 1)?,
                    None => return source.error(at, "#import what?"),
                },
                Some("#if") => {
                    let close = source.end_of(at)?;
                    let condition = line.trim_start().trim_start_matches("#if");
                    if self.value(source, at, condition)? != 0 {
                        self.lines(source, at + 1, close)?;
                    }
                    at = close;
                }
                Some("#repeat") => {
                    let close = source.end_of(at)?;
                    self.repeat(source, at, close)?;
                    at = close;
                }
                Some(word) if word.starts_with('#') => return source.error(at, format!("what is {word}?")),
                _ => self.plain(source, at)?,
            }
            at += 1;
        }
        Ok(())
    }

    fn repeat(&mut self, source: &Lines<'_>, at: usize, close: usize) -> Result<(), ComposeError> {
        let head = source.lines[at].trim_start().trim_start_matches("#repeat");
        let parts = head.split_once(" in ").and_then(|(name, range)| Some((name.trim(), range.split_once("..")?)));
        let Some((name, (first, last))) = parts else {
            return source.error(at, "expected `#repeat NAME in A..B`");
        };
        let range = self.value(source, at, first)?..self.value(source, at, last)?;
        for k in range {
            self.scope.push((name.to_owned(), k));
            let done = self.lines(source, at + 1, close);
            self.scope.pop();
            done?;
        }
        Ok(())
    }

    /// A line with its `$` replaced.
    fn plain(&mut self, source: &Lines<'_>, at: usize) -> Result<(), ComposeError> {
        let mut rest = source.lines[at];
        while let Some(dollar) = rest.find('$') {
            self.out.push_str(&rest[..dollar]);
            rest = &rest[dollar + 1..];
            let length = if rest.starts_with('(') {
                closing(rest)
            } else {
                Some(rest.find(|c: char| !c.is_ascii_uppercase()).unwrap_or(rest.len())).filter(|n| *n > 0)
            };
            let Some(length) = length else { return source.error(at, "`$` without an expression") };
            let value = self.value(source, at, &rest[..length])?;
            self.out.push_str(&value.to_string());
            rest = &rest[length..];
        }
        self.out.push_str(rest);
        self.out.push('\n');
        Ok(())
    }

    fn value(&self, source: &Lines<'_>, at: usize, text: &str) -> Result<i64, ComposeError> {
        let mut parser = Expression { scope: &self.scope, rest: text.trim() };
        let value = parser.comparison().filter(|_| parser.rest.is_empty());
        value.map_or_else(|| source.error(at, format!("cannot evaluate `{}`", text.trim())), Ok)
    }
}

/// Length of the parenthesis that `text` begins with.
fn closing(text: &str) -> Option<usize> {
    let mut depth = 0;
    for (k, c) in text.char_indices() {
        depth += i32::from(c == '(') - i32::from(c == ')');
        if depth == 0 {
            return Some(k + 1);
        }
    }
    None
}

type Operator = fn(i64, i64) -> Option<i64>;

/// A recursive-descent evaluator; `rest` never begins with a blank.
struct Expression<'a> {
    scope: &'a [(String, i64)],
    rest: &'a str,
}

impl Expression<'_> {
    fn take(&mut self, c: char) -> bool {
        let taken = self.rest.strip_prefix(c);
        if let Some(rest) = taken {
            self.rest = rest.trim_start();
        }
        taken.is_some()
    }

    fn comparison(&mut self) -> Option<i64> {
        let left = self.sum()?;
        if self.take('<') { Some(i64::from(left < self.sum()?)) } else { Some(left) }
    }

    fn sum(&mut self) -> Option<i64> {
        self.chain([('+', i64::checked_add), ('-', i64::checked_sub)], Self::product)
    }

    fn product(&mut self) -> Option<i64> {
        self.chain([('*', i64::checked_mul), ('%', i64::checked_rem)], Self::atom)
    }

    /// Operands with these operators between them, from left to right.
    fn chain(&mut self, operators: [(char, Operator); 2], operand: fn(&mut Self) -> Option<i64>) -> Option<i64> {
        let mut value = operand(self)?;
        while let Some((_, apply)) = operators.into_iter().find(|(sign, _)| self.take(*sign)) {
            value = apply(value, operand(self)?)?;
        }
        Some(value)
    }

    fn atom(&mut self) -> Option<i64> {
        if self.take('(') {
            let value = self.comparison()?;
            return self.take(')').then_some(value);
        }
        let length = self.rest.find(|c: char| !c.is_ascii_alphanumeric()).unwrap_or(self.rest.len());
        let (word, rest) = self.rest.split_at(length);
        self.rest = rest.trim_start();
        word.parse().ok().or_else(|| self.scope.iter().rev().find(|(n, _)| n == word).map(|(_, v)| *v))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STRAW: Sources = &[("shared/state", "struct State {\n}")];

    fn text(lines: &str, constants: &[Constant<'_>]) -> Result<String, ComposeError> {
        let source = Lines { file: "test", lines: lines.lines().collect() };
        let scope = constants.iter().map(|(n, v)| ((*n).to_owned(), *v)).collect();
        let mut composer = Composer { sources: STRAW, out: String::new(), imported: BTreeSet::new(), scope };
        composer.lines(&source, 0, source.lines.len())?;
        Ok(composer.out)
    }

    #[test]
    fn repeats_nest_and_evaluate() {
        let source = "#repeat K in 0..N\na_$K $((K + 1) % N)\n#repeat S in K..2\n#if S < K + 1\n  b_$(K)_$(S*2)\n#end\n#end\n#end";
        assert_eq!(text(source, &[("N", 2)]).unwrap(), "a_0 1\n  b_0_0\na_1 0\n  b_1_2\n");
    }

    #[test]
    fn imports_come_once() {
        let once = text("#import shared/state", &[]).unwrap();
        assert_eq!(text("#import shared/state\n#import shared/state", &[]).unwrap(), once);
        assert!(once.contains("struct State"));
    }

    #[test]
    fn mistakes_name_their_line() {
        for (source, line) in [
            ("x\n#if 1", 2),
            ("#import nowhere", 1),
            ("$", 1),
            ("\n\n$(1 +)", 3),
            ("#frob", 1),
            ("#repeat K 0..1\n#end", 1),
        ] {
            assert_eq!(text(source, &[]).unwrap_err().line, line, "{source:?}");
        }
    }
}
