//! Links of the documents lead to files and headings that exist.

use std::collections::BTreeSet;

use super::{pages, place, prose, read};

/// The names under which a page's headings can be linked to, as forges make them.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for (_, line) in prose(text) {
        let Some(title) = line.strip_prefix('#').map(|rest| rest.trim_start_matches('#').trim()) else { continue };
        let kept = title.chars().filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c));
        let name = kept.collect::<String>().to_lowercase().replace(' ', "-");
        let again = (1..).map(|number| format!("{name}-{number}"));
        let free = std::iter::once(name.clone()).chain(again).find(|name| !found.contains(name));
        found.extend(free);
    }
    found
}

/// Targets of the links on a line.
fn targets(line: &str) -> Vec<&str> {
    line.match_indices("](").filter_map(|(at, _)| line[at + 2..].split(')').next()).collect()
}

/// What is wrong with a link on `page`.
fn fault(page: &str, target: &str) -> Option<String> {
    if target.starts_with("http://") || target.starts_with("https://") {
        return None;
    }
    let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
    let folder = page.rsplit_once('/').map_or("", |(folder, _)| folder);
    let path = match file {
        "" => place(page),
        file => place(folder).join(file),
    };
    if !path.exists() {
        return Some("there is no such file".to_owned());
    }
    if anchor.is_empty() {
        return None;
    }
    let text = std::fs::read_to_string(&path).unwrap_or_default();
    (!anchors(&text).contains(anchor)).then(|| "there is no such heading".to_owned())
}

#[test]
fn links_lead_somewhere() {
    let mut wrong = Vec::new();
    for page in pages() {
        let text = read(&page);
        for (number, line) in prose(&text) {
            let faults = targets(line).into_iter().filter_map(|target| Some((target, fault(&page, target)?)));
            wrong.extend(faults.map(|(target, fault)| format!("{page}:{number}: {target}: {fault}")));
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

/// Pages for developers name sources, within backquotes; a name with capitals is a pattern. CHANGELOG.md names what was.
#[test]
fn sources_that_pages_name_exist() {
    let mut wrong = Vec::new();
    for page in pages().into_iter().filter(|page| page != "CHANGELOG.md") {
        let text = read(&page);
        for (number, line) in prose(&text) {
            let named = line.split('`').skip(1).step_by(2);
            let sources = named.filter(|name| name.starts_with("src/") || name.starts_with("tests/"));
            let sources = sources.filter(|name| name.ends_with(".rs") && !name.contains(char::is_uppercase));
            wrong.extend(sources.filter(|name| !place(name).exists()).map(|name| format!("{page}:{number}: {name}")));
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn headings_are_named_as_forges_name_them() {
    let text = "# A page\n## What a job needs\n```sh\n# no heading\n```\n## `Read`, and more\n## A page\n";
    let names = ["a-page", "a-page-1", "read-and-more", "what-a-job-needs"];
    assert_eq!(anchors(text), names.map(str::to_owned).into());
    assert_eq!(targets("[a](b.md) and ![c](d.png)"), ["b.md", "d.png"]);
}
