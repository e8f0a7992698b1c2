//! Just enough of a shell to find the program's commands in examples.

/// The arguments of every `augnerf` command in lines of shell: quotes, comments, continued lines, pipes, redirections and
/// assignments before a command are understood. Variables and globs stay as they are.
pub fn commands(text: &str) -> Vec<Vec<String>> {
    let joined = text.replace("\\\n", " ");
    joined.lines().flat_map(commands_of_line).collect()
}

fn commands_of_line(line: &str) -> Vec<Vec<String>> {
    let words = words(line);
    let is = |word: &str, operators: &str| word.len() == 1 && operators.contains(word);
    let commands = words.split(|word| is(word, "|;&")).map(|command| {
        // The word behind a redirection is a file.
        let redirects = |at: usize| command.get(at).is_some_and(|word| is(word, "<>"));
        let own = (0..command.len()).filter(|&at| !redirects(at) && !redirects(at.wrapping_sub(1)));
        own.map(|at| command[at].clone()).collect::<Vec<String>>()
    });
    commands.filter_map(|command| arguments(&command)).collect()
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

/// Words of a line; operators are words of their own.
fn words(line: &str) -> Vec<String> {
    let mut words = Vec::new();
    let mut word: Option<String> = None;
    let mut characters = line.chars();
    while let Some(c) = characters.next() {
        match c {
            '#' if word.is_none() => break,
            '\'' | '"' => word.get_or_insert_default().extend(characters.by_ref().take_while(|other| *other != c)),
            '\\' => word.get_or_insert_default().extend(characters.next()),
            ' ' | '\t' => words.extend(word.take()),
            '|' | ';' | '&' | '>' | '<' => words.extend(word.take().into_iter().chain([c.to_string()])),
            other => word.get_or_insert_default().push(other),
        }
    }
    words.extend(word);
    words
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
