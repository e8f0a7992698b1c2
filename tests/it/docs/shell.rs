//! Just enough of a shell to find the program's commands in examples.

/// A word of a line, or what ends a command.
enum Token {
    Word(String),
    /// `>`, `<`: the next word is a file.
    Redirect,
    /// `|`, `;`, `&`: another command follows.
    End,
}

/// The arguments of every `augnerf` command in lines of shell: quotes, comments, continued lines, pipes, redirections and
/// assignments before a command are understood. Variables and globs stay as they are.
pub fn commands(text: &str) -> Vec<Vec<String>> {
    let joined = text.replace("\\\n", " ");
    joined.lines().flat_map(commands_of_line).collect()
}

fn commands_of_line(line: &str) -> Vec<Vec<String>> {
    let mut commands = vec![Vec::new()];
    let mut redirected = false;
    for token in tokens(line) {
        match token {
            Token::End => commands.push(Vec::new()),
            Token::Redirect => redirected = true,
            Token::Word(_) if std::mem::take(&mut redirected) => {}
            Token::Word(word) => commands.last_mut().expect("never empty").push(word),
        }
    }
    commands.into_iter().filter_map(|words| arguments(&words)).collect()
}

/// What the program is given; none for other programs' commands.
fn arguments(words: &[String]) -> Option<Vec<String>> {
    let assignment = |word: &&String| {
        word.split_once('=').is_some_and(|(name, _)| name.bytes().all(|b| b.is_ascii_uppercase() || b == b'_'))
    };
    let start = words.iter().take_while(assignment).count();
    let (program, rest) = words[start..].split_first()?;
    match program.rsplit('/').next()? {
        "augnerf" => Some(rest.to_vec()),
        "cargo" if rest.first()? == "run" => {
            let own = rest.iter().position(|word| word == "--")?;
            Some(rest[own + 1..].to_vec())
        }
        _ => None,
    }
}

fn tokens(line: &str) -> Vec<Token> {
    let mut tokens = Vec::new();
    let mut word: Option<String> = None;
    let mut characters = line.chars();
    while let Some(c) = characters.next() {
        match c {
            '#' if word.is_none() => break,
            '\'' => word.get_or_insert_default().extend(characters.by_ref().take_while(|c| *c != '\'')),
            '"' => word.get_or_insert_default().extend(characters.by_ref().take_while(|c| *c != '"')),
            '\\' => word.get_or_insert_default().extend(characters.next()),
            ' ' | '\t' | '|' | ';' | '&' | '>' | '<' => {
                tokens.extend(word.take().map(Token::Word));
                match c {
                    '|' | ';' | '&' => tokens.push(Token::End),
                    '>' | '<' => tokens.push(Token::Redirect),
                    _ => {}
                }
            }
            other => word.get_or_insert_default().push(other),
        }
    }
    tokens.extend(word.map(Token::Word));
    tokens
}

#[test]
fn commands_are_found_as_a_shell_finds_them() {
    let text = "AUGNERF_DATA=~/data augnerf sweep run a.toml \\\n  --jobs 2   # two at once\ncargo run --release -- train\n\
                ls | target/release/augnerf measure 'a b' > $OUT; augnerf train --set 'regularizer.kind=[\"tv\"]'\n# augnerf no";
    let expected: [&[&str]; 4] = [
        &["sweep", "run", "a.toml", "--jobs", "2"],
        &["train"],
        &["measure", "a b"],
        &["train", "--set", "regularizer.kind=[\"tv\"]"],
    ];
    assert_eq!(commands(text), expected);
}
