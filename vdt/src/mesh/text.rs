//! Text files, word by word: what ASCII PLY, OBJ, ASCII STL and OFF share.
//!
//! Lines may be of any length, since no line is ever held; only a single word is, in the window of [`Input`], and
//! words are at most [`WORD_LIMIT`] bytes. Lines end with LF, CR LF or CR. Nothing is allocated.

use std::fmt;
use std::path::Path;

use storage::Disk;

use super::MeshError;
use super::input::Input;

/// The longest word that is accepted. The longest number that means anything has about 1100 digits.
pub(super) const WORD_LIMIT: usize = 4096;

/// What separates words within a line.
#[inline]
fn is_blank(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | 0x0b | 0x0c)
}

#[inline]
fn is_line_end(byte: u8) -> bool {
    matches!(byte, b'\n' | b'\r')
}

/// What a text format does with two characters that are not plain text everywhere.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Syntax {
    /// A word that begins with this byte begins a comment, up to the end of the line.
    pub comment: Option<u8>,
    /// A backslash at the end of a line joins the next line to it.
    pub continuation: bool,
}

/// Reads a text file word by word, and counts its lines.
#[derive(Debug)]
pub(super) struct Scanner {
    input: Input,
    syntax: Syntax,
    line: u64,
    /// Whether the first line ended with a CR alone, so that all do.
    carriage_returns: bool,
}

impl Scanner {
    /// Opens `path`, and steps over a byte order mark.
    pub fn open(disk: &dyn Disk, path: &Path, syntax: Syntax) -> Result<Self, MeshError> {
        let mut input = Input::open(disk, path)?;
        if input.peek(3)?.starts_with(BYTE_ORDER_MARK) {
            input.consume(BYTE_ORDER_MARK.len());
        }
        Ok(Scanner { input, syntax, line: 1, carriage_returns: false })
    }

    /// Number of the current line, counted from 1.
    pub fn line(&self) -> u64 {
        self.line
    }

    /// The file, right behind what was scanned.
    pub fn into_input(self) -> Input {
        self.input
    }

    /// Whether the file ends here.
    pub fn is_at_end(&mut self) -> Result<bool, MeshError> {
        Ok(self.input.is_at_end()?)
    }

    /// A [`MeshError::Malformed`] at the current line.
    pub fn malformed(&self, problem: impl Into<String>) -> MeshError {
        MeshError::malformed(self.input.path(), format!("line {}", self.line), problem)
    }

    /// The next word of the current line; none at its end.
    #[inline]
    pub fn word(&mut self) -> Result<Option<&[u8]>, MeshError> {
        loop {
            let ahead = self.input.peek(WORD_LIMIT + 1)?;
            let Some(&first) = ahead.first() else { return Ok(None) };
            if is_blank(first) {
                let blanks = ahead.iter().position(|&byte| !is_blank(byte)).unwrap_or(ahead.len());
                self.input.consume(blanks);
            } else if is_line_end(first) {
                return Ok(None);
            } else if self.syntax.comment == Some(first) {
                self.skip_to_line_end()?;
                return Ok(None);
            } else if self.syntax.continuation && first == b'\\' && self.joins_lines()? {
                self.input.consume(1);
                self.end_line()?;
            } else {
                return self.word_ahead().map(Some);
            }
        }
    }

    /// Whether the backslash ahead is the last byte of its line.
    fn joins_lines(&mut self) -> Result<bool, MeshError> {
        Ok(self.input.peek(2)?.get(1).is_some_and(|&byte| is_line_end(byte)))
    }

    #[inline]
    fn word_ahead(&mut self) -> Result<&[u8], MeshError> {
        let ahead = self.input.peek(WORD_LIMIT + 1)?;
        let end = ahead.iter().position(|&byte| is_blank(byte) || is_line_end(byte));
        let mut length = end.unwrap_or(ahead.len());
        if length > WORD_LIMIT {
            let problem = format!("a word of more than {WORD_LIMIT} bytes; this does not look like a text file");
            return Err(self.malformed(problem));
        }
        let joined = self.syntax.continuation && length > 1 && ahead[length - 1] == b'\\';
        if joined && ahead.get(length).is_some_and(|&byte| is_line_end(byte)) {
            // The next call sees the backslash.
            length -= 1;
        }
        Ok(self.input.take(length))
    }

    /// Moves on to the next line that has a word, which may be the current one, and reads that word; none at the end
    /// of the file.
    #[inline]
    pub fn word_on_any_line(&mut self) -> Result<Option<&[u8]>, MeshError> {
        while self.at_line_end()? {
            if !self.next_line()? {
                return Ok(None);
            }
        }
        self.word()
    }

    /// Whether the current line has no more words.
    #[inline]
    pub fn at_line_end(&mut self) -> Result<bool, MeshError> {
        loop {
            let ahead = self.input.peek(2)?;
            let Some(&first) = ahead.first() else { return Ok(true) };
            if is_blank(first) {
                let blanks = ahead.iter().position(|&byte| !is_blank(byte)).unwrap_or(ahead.len());
                self.input.consume(blanks);
            } else if self.syntax.continuation && first == b'\\' && self.joins_lines()? {
                self.input.consume(1);
                self.end_line()?;
            } else {
                return Ok(is_line_end(first) || self.syntax.comment == Some(first));
            }
        }
    }

    fn skip_to_line_end(&mut self) -> Result<(), MeshError> {
        loop {
            let ahead = self.input.peek(1)?;
            if ahead.is_empty() {
                return Ok(());
            }
            match ahead.iter().position(|&byte| is_line_end(byte)) {
                Some(count) => {
                    self.input.consume(count);
                    return Ok(());
                }
                None => {
                    let count = ahead.len();
                    self.input.consume(count);
                }
            }
        }
    }

    /// Steps over the end of a line, which lies ahead. False at the end of the file.
    fn end_line(&mut self) -> Result<bool, MeshError> {
        let ahead = self.input.peek(2)?;
        let (first, second) = (ahead.first().copied(), ahead.get(1).copied());
        if self.line == 1 {
            self.carriage_returns = first == Some(b'\r') && second != Some(b'\n');
        }
        match (first, second) {
            (None, _) => return Ok(false),
            (Some(b'\r'), Some(b'\n')) if !self.carriage_returns => self.input.consume(2),
            _ => self.input.consume(1),
        }
        self.line += 1;
        Ok(true)
    }

    /// Moves to the start of the next line, whatever is left of this one. False at the end of the file.
    #[inline]
    pub fn next_line(&mut self) -> Result<bool, MeshError> {
        self.skip_to_line_end()?;
        self.end_line()
    }

    /// Whether the next word of the current line is this one.
    pub fn is_ahead(&mut self, word: &[u8]) -> Result<bool, MeshError> {
        if self.at_line_end()? {
            return Ok(false);
        }
        let behind = self.input.peek(word.len() + 1)?.strip_prefix(word);
        Ok(behind.is_some_and(|behind| behind.first().is_none_or(|&byte| is_blank(byte) || is_line_end(byte))))
    }

    /// The rest of the current line without blanks around it, as a name may have blanks in it; a comment behind a blank is
    /// no part of it. A backslash at its end joins nothing.
    pub fn rest_of_line(&mut self) -> Result<String, MeshError> {
        if self.at_line_end()? {
            return Ok(String::new());
        }
        let ahead = self.input.peek(WORD_LIMIT + 1)?;
        let mut length = ahead.iter().position(|&byte| is_line_end(byte)).unwrap_or(ahead.len());
        let comment = self.syntax.comment;
        if let Some(blank) = ahead[..length].windows(2).position(|pair| is_blank(pair[0]) && Some(pair[1]) == comment) {
            length = blank;
        }
        if length > WORD_LIMIT {
            return Err(self.malformed(format!("a name of more than {WORD_LIMIT} bytes")));
        }
        Ok(String::from_utf8_lossy(self.input.take(length)).trim().to_string())
    }

    /// Moves past the words that are left of the current line and of the lines joined to it.
    pub fn skip_words(&mut self) -> Result<(), MeshError> {
        while self.word()?.is_some() {}
        Ok(())
    }
}

/// UTF-8's byte order mark.
pub(super) const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// A word as a message shows it: quoted, escaped, and cut where it is long.
pub(super) struct Shown<'a>(pub &'a [u8]);

impl fmt::Display for Shown<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        const LONGEST: usize = 40;
        let start = &self.0[..self.0.len().min(LONGEST)];
        let more = if self.0.len() > LONGEST { "..." } else { "" };
        write!(out, "'{}{more}'", start.escape_ascii())
    }
}

/// A whole number in decimal digits, with an optional sign. None if it is not one, or does not fit.
#[inline]
pub(super) fn parse_integer(word: &[u8]) -> Option<i64> {
    let (negative, digits) = match word {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, word),
    };
    if digits.is_empty() {
        return None;
    }
    digits.iter().try_fold(0_i64, |value, byte| {
        let digit = byte.wrapping_sub(b'0');
        let shifted = if digit < 10 { value.checked_mul(10)? } else { return None };
        if negative { shifted.checked_sub(digit.into()) } else { shifted.checked_add(digit.into()) }
    })
}

/// A number as text, not necessarily finite. None if it is not one.
#[inline]
pub(super) fn parse_real(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    text.parse().ok().or_else(|| parse_old_not_finite(text))
}

/// NaN and infinity as the C libraries of some systems print them: `1.#QNAN`, `-1.#IND00`, `1.#INF`, `-nan(ind)`.
#[cold]
fn parse_old_not_finite(text: &str) -> Option<f64> {
    let text = text.to_ascii_lowercase();
    let (sign, text) = match text.strip_prefix('-') {
        Some(rest) => (-1.0, rest),
        None => (1.0, text.as_str()),
    };
    if text.starts_with("1.#inf") {
        Some(sign * f64::INFINITY)
    } else if ["1.#qnan", "1.#snan", "1.#ind", "nan("].iter().any(|start| text.starts_with(start)) {
        Some(f64::NAN)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use storage::MemoryDisk;

    use super::*;

    const PLAIN: Syntax = Syntax { comment: None, continuation: false };
    const OBJ: Syntax = Syntax { comment: Some(b'#'), continuation: true };

    fn scanner_of(text: impl AsRef<[u8]>, syntax: Syntax) -> Scanner {
        let disk = MemoryDisk::new();
        disk.insert("file", text.as_ref());
        Scanner::open(&disk, Path::new("file"), syntax).unwrap()
    }

    /// The words of each line, with the number of the line on which the last one stands.
    fn lines_of(text: impl AsRef<[u8]>, syntax: Syntax) -> Vec<(u64, Vec<String>)> {
        let mut scanner = scanner_of(text, syntax);
        let mut lines = Vec::new();
        loop {
            let mut words = Vec::new();
            while let Some(word) = scanner.word().unwrap() {
                words.push(String::from_utf8_lossy(word).into_owned());
            }
            lines.push((scanner.line(), words));
            if !scanner.next_line().unwrap() {
                return lines;
            }
        }
    }

    fn words(text: &str) -> Vec<String> {
        text.split(' ').filter(|word| !word.is_empty()).map(str::to_string).collect()
    }

    #[test]
    fn all_three_line_ends_count_alike() {
        let expected = vec![(1, words("a b")), (2, words("")), (3, words("c")), (4, words(""))];
        for end in ["\n", "\r\n", "\r"] {
            let text = ["a\tb ", "", "c", ""].join(end);
            assert_eq!(lines_of(&text, PLAIN), expected, "{text:?}");
        }
    }

    #[test]
    fn a_byte_order_mark_is_no_word() {
        assert_eq!(lines_of("\u{feff}a", PLAIN), [(1, words("a"))]);
    }

    #[test]
    fn comments_end_with_their_line_and_begin_with_a_word() {
        let expected = vec![(1, words("a b#c")), (2, words("")), (3, words("d"))];
        assert_eq!(lines_of("a b#c # d\n# e \\\nd", OBJ), expected);
    }

    #[test]
    fn a_backslash_joins_lines() {
        for text in ["a \\\nb\\\n c", "a \\\r\nb\\\r\n c", "a \\\rb\\\r c"] {
            assert_eq!(lines_of(text, OBJ), [(3, words("a b c"))], "{text:?}");
        }
        assert_eq!(lines_of("a\\b \\ c\\", OBJ), [(1, words("a\\b \\ c\\"))]);
        assert_eq!(lines_of("a\\\nb", PLAIN), [(1, words("a\\")), (2, words("b"))]);
    }

    #[test]
    fn a_word_may_straddle_windows_and_a_line_may_be_longer_than_one() {
        let long: Vec<String> = (0..100_000).map(|number| format!("word{number}")).collect();
        assert_eq!(lines_of(long.join("  "), PLAIN), [(1, long)]);
        let comment = format!("#{}\nend", "x".repeat(1_000_000));
        assert_eq!(lines_of(comment, OBJ), [(1, words("")), (2, words("end"))]);
    }

    #[test]
    fn a_word_without_an_end_is_refused() {
        let longest = "x".repeat(WORD_LIMIT);
        assert_eq!(lines_of(&longest, PLAIN), [(1, words(&longest))]);
        let mut scanner = scanner_of(format!("\n{longest}x"), PLAIN);
        assert!(scanner.next_line().unwrap());
        let message = scanner.word().unwrap_err().to_string();
        assert_eq!(message, "file: line 2: a word of more than 4096 bytes; this does not look like a text file");
    }

    #[test]
    fn words_on_any_line_skip_what_has_none() {
        let mut scanner = scanner_of("\n  # a\n\n b c \\\n\n# d\ne", OBJ);
        let mut found = Vec::new();
        while let Some(word) = scanner.word_on_any_line().unwrap() {
            found.push(String::from_utf8_lossy(word).into_owned());
        }
        assert_eq!(found, ["b", "c", "e"]);
        assert_eq!(scanner.line(), 7);
    }

    #[test]
    fn the_rest_of_a_line_is_a_name_with_blanks() {
        for (text, expected) in [
            ("map_Kd  my picture.png \t\r\nnext", "my picture.png"),
            ("map_Kd C:\\a b\\\nnext", "C:\\a b\\"),
            ("map_Kd a#b # comment\nnext", "a#b"),
            ("map_Kd # comment\nnext", ""),
            ("map_Kd\nnext", ""),
            ("map_Kd \u{e9}", "\u{e9}"),
        ] {
            let mut scanner = scanner_of(text, OBJ);
            assert_eq!(scanner.word().unwrap(), Some(b"map_Kd".as_slice()));
            assert_eq!(scanner.rest_of_line().unwrap(), expected, "{text}");
            if scanner.next_line().unwrap() {
                assert_eq!(scanner.word().unwrap(), Some(b"next".as_slice()), "{text}");
            }
        }
        let mut scanner = scanner_of(format!("usemtl {}", "a ".repeat(3000)), OBJ);
        scanner.word().unwrap();
        assert_eq!(scanner.rest_of_line().unwrap_err().to_string(), "file: line 1: a name of more than 4096 bytes");
    }

    #[test]
    fn integers_that_do_not_fit_are_none() {
        let good =
            [("0", 0), ("-0", 0), ("+17", 17), ("-9223372036854775808", i64::MIN), ("9223372036854775807", i64::MAX)];
        for (word, value) in good {
            assert_eq!(parse_integer(word.as_bytes()), Some(value), "{word}");
        }
        for word in
            ["", "-", "+", "1.0", "0x10", "1e3", "9223372036854775808", "18446744073709551617", "1-", "--1", "one"]
        {
            assert_eq!(parse_integer(word.as_bytes()), None, "{word}");
        }
    }

    #[test]
    fn reals_may_be_no_finite_numbers() {
        for (word, value) in [("1", 1.0), ("-.5", -0.5), ("2.", 2.0), ("+1e-3", 0.001), ("-1.#INF", f64::NEG_INFINITY)]
        {
            assert_eq!(parse_real(word.as_bytes()), Some(value), "{word}");
        }
        for word in ["nan", "NaN", "-nan", "-nan(ind)", "1.#QNAN", "-1.#IND00"] {
            assert!(parse_real(word.as_bytes()).unwrap().is_nan(), "{word}");
        }
        for word in ["inf", "Infinity", "1e999", "1.#INF00"] {
            assert_eq!(parse_real(word.as_bytes()), Some(f64::INFINITY), "{word}");
        }
        for word in ["", "1,5", "0x1p3", "1.0.0", "abc", "\u{b5}"] {
            assert_eq!(parse_real(word.as_bytes()), None, "{word}");
        }
        assert_eq!(parse_real(b"\xff"), None);
    }

    #[test]
    fn a_shown_word_is_escaped_and_cut() {
        assert_eq!(Shown(b"a\0\xff").to_string(), "'a\\x00\\xff'");
        assert_eq!(Shown(&[b'x'; 100]).to_string(), format!("'{}...'", "x".repeat(40)));
    }
}
