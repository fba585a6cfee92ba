//! The crate's own sources, as modules and the paths that they name. For tests of its structure.
//!
//! A file is parsed, not searched: what is compiled for tests alone is left out, item by item; everything else counts,
//! whatever its features. Paths are those of `use` trees, of types and expressions, and of the tokens of macros and
//! attributes. What a path leads to is found through `crate`, `self`, `super`, child modules and imports, globs too;
//! methods and fields have no paths, and a macro that this crate defines is not expanded.

use std::collections::{BTreeMap, BTreeSet};

use proc_macro2::{Delimiter, Span, TokenStream, TokenTree};
use syn::punctuated::Punctuated;
use syn::visit::{self, Visit};
use syn::{Attribute, Item, Meta, Token, UseTree};

/// A crate's modules, those of its program included.
#[derive(Default)]
pub struct Tree {
    pub modules: Vec<Module>,
    /// Files that are compiled for tests alone, below `src`, without ending.
    pub test_files: Vec<String>,
    /// Modules by their paths.
    places: BTreeMap<Vec<String>, usize>,
}

/// A module: a file, or a part of one.
#[derive(Default)]
pub struct Module {
    /// From the root of the crate, which has none; `main` is the root of the program.
    pub path: Vec<String>,
    /// Below `src`, without ending.
    pub file: String,
    pub uses: Vec<Use>,
    /// Macros that are called, and where.
    pub macros: Vec<(String, usize)>,
    children: BTreeSet<String>,
    items: BTreeSet<String>,
    imports: BTreeMap<String, Vec<String>>,
    globs: Vec<Vec<String>>,
}

/// A path that a module names.
pub struct Use {
    /// As written. Empty is what stands before a leading `::`.
    pub path: Vec<String>,
    pub line: usize,
}

/// What a path leads to.
#[derive(Debug, PartialEq)]
pub enum Target {
    /// A path from the root of this crate.
    Here(Vec<String>),
    /// Another crate, if the first name is one.
    Crate(String),
    Unknown,
}

/// How many imports are followed one after the other.
const MOST_STEPS: usize = 16;

impl Tree {
    /// Reads the library and the program. `load` gives a file's text: `mesh/io` is `src/geometry/mesh/io.rs`.
    pub fn read(load: &dyn Fn(&str) -> Option<String>) -> Self {
        let mut tree = Self::default();
        for (root, path) in [("lib", Vec::new()), ("main", vec!["main".to_owned()])] {
            tree.file(root, path, load);
        }
        tree
    }

    fn file(&mut self, file: &str, path: Vec<String>, load: &dyn Fn(&str) -> Option<String>) {
        let Some(text) = load(file) else {
            assert!(path == ["main"], "src/{file}.rs is declared and is not there");
            return;
        };
        let parsed = syn::parse_file(&text).unwrap_or_else(|e| panic!("src/{file}.rs:{}: {e}", e.span().start().line));
        let at = self.add(path, file);
        let mut reader = Reader { tree: self, at, files: Vec::new() };
        reader.visit_file(&parsed);
        for (file, path) in reader.files {
            self.file(&file, path, load);
        }
    }

    fn add(&mut self, path: Vec<String>, file: &str) -> usize {
        let at = self.modules.len();
        self.places.insert(path.clone(), at);
        self.modules.push(Module { path, file: file.to_owned(), ..Module::default() });
        at
    }

    pub fn module(&self, path: &[String]) -> Option<usize> {
        self.places.get(path).copied()
    }

    /// What `path` means in a module, before anything is followed that other modules import.
    pub fn resolve(&self, at: usize, path: &[String]) -> Target {
        self.step(at, path, None, 0)
    }

    fn step(&self, at: usize, path: &[String], not: Option<&str>, steps: usize) -> Target {
        let module = &self.modules[at];
        let Some((first, rest)) = path.split_first().filter(|_| steps < MOST_STEPS) else { return Target::Unknown };
        let under = |base: &[String], rest: &[String]| Target::Here([base, rest].concat());
        let root = if module.path.first().is_some_and(|m| m == "main") { 1 } else { 0 };
        match first.as_str() {
            "" => return rest.first().map_or(Target::Unknown, |name| Target::Crate(name.clone())),
            "crate" => return under(&module.path[..root], rest),
            "tessera" if root == 1 => return under(&[], rest),
            "self" => return under(&module.path, rest),
            "super" => {
                let up = path.iter().take_while(|s| *s == "super").count();
                let base = module.path.len().checked_sub(up).unwrap_or_else(|| panic!("{}: {path:?}", module.file));
                return under(&module.path[..base], &path[up..]);
            }
            "Self" => return Target::Unknown,
            _ => {}
        }
        if module.children.contains(first) || module.items.contains(first) {
            return under(&module.path, path);
        }
        if let Some(import) = module.imports.get(first).filter(|_| not != Some(first)) {
            return self.step(at, &[import.as_slice(), rest].concat(), Some(first), steps + 1);
        }
        for glob in &module.globs {
            let Target::Here(from) = self.step(at, glob, None, steps + 1) else { continue };
            match self.module(&from) {
                Some(other) if other != at && self.modules[other].knows(first) => {
                    return self.step(other, path, None, steps + 1);
                }
                _ => {}
            }
        }
        if rest.is_empty() { Target::Unknown } else { Target::Crate(first.clone()) }
    }

    /// The module where what lies at `path` is defined, through all that is imported on the way.
    pub fn home(&self, path: &[String]) -> Option<usize> {
        self.follow(path, 0)
    }

    fn follow(&self, path: &[String], steps: usize) -> Option<usize> {
        let mut at = self.module(&[])?;
        for (i, name) in path.iter().enumerate() {
            let module = &self.modules[at];
            if let Some(child) = self.module(&path[..=i]) {
                at = child;
                continue;
            }
            if module.items.contains(name) || !module.knows(name) && module.globs.is_empty() {
                break;
            }
            return match self.step(at, &path[i..], None, steps) {
                Target::Here(there) if there != path && steps < MOST_STEPS => self.follow(&there, steps + 1),
                Target::Crate(_) => None,
                _ => Some(at),
            };
        }
        Some(at)
    }
}

impl Module {
    fn knows(&self, name: &str) -> bool {
        self.children.contains(name) || self.items.contains(name) || self.imports.contains_key(name)
    }
}

/// Reads one file.
struct Reader<'a> {
    tree: &'a mut Tree,
    at: usize,
    /// Files that are declared in it, and their paths.
    files: Vec<(String, Vec<String>)>,
}

impl Reader<'_> {
    fn here(&mut self) -> &mut Module {
        &mut self.tree.modules[self.at]
    }

    fn name(&mut self, path: Vec<String>, span: Span) {
        let line = span.start().line;
        self.here().uses.push(Use { path, line });
    }

    /// The file of a child module.
    fn file_of(&self, child: &str) -> String {
        match self.tree.modules[self.at].path.as_slice() {
            [] => child.to_owned(),
            [main] if main == "main" => child.to_owned(),
            path => format!("{}/{child}", path.join("/")),
        }
    }

    fn declare(&mut self, item: &syn::ItemMod) {
        let name = item.ident.to_string();
        let path = [self.here().path.as_slice(), std::slice::from_ref(&name)].concat();
        self.here().children.insert(name.clone());
        match &item.content {
            None => self.files.push((self.file_of(&name), path)),
            Some((_, items)) => {
                let (outer, file) = (self.at, self.here().file.clone());
                self.at = self.tree.add(path, &file);
                items.iter().for_each(|item| self.visit_item(item));
                self.at = outer;
            }
        }
    }

    fn import(&mut self, before: &[String], tree: &UseTree) {
        let with = |name: &syn::Ident| [before, &[name.to_string()]].concat();
        match tree {
            UseTree::Path(path) => self.import(&with(&path.ident), &path.tree),
            UseTree::Group(group) => group.items.iter().for_each(|tree| self.import(before, tree)),
            UseTree::Name(name) if name.ident == "self" => {
                self.bind(before.last().cloned().unwrap_or_default(), before.to_vec(), name.ident.span());
            }
            UseTree::Name(name) => self.bind(name.ident.to_string(), with(&name.ident), name.ident.span()),
            UseTree::Rename(name) if name.ident == "self" => {
                self.bind(name.rename.to_string(), before.to_vec(), name.ident.span());
            }
            UseTree::Rename(name) => self.bind(name.rename.to_string(), with(&name.ident), name.ident.span()),
            UseTree::Glob(glob) => {
                self.here().globs.push(before.to_vec());
                self.name(before.to_vec(), glob.star_token.spans[0]);
            }
        }
    }

    fn bind(&mut self, name: String, path: Vec<String>, span: Span) {
        self.here().imports.insert(name, path.clone());
        self.name(path, span);
    }

    /// Paths in what a macro or an attribute is given, and macros that are called there.
    fn tokens(&mut self, tokens: TokenStream) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let punct = |i: usize, c: char| matches!(tokens.get(i), Some(TokenTree::Punct(p)) if p.as_char() == c);
        let colons = |i: usize| punct(i, ':') && punct(i + 1, ':');
        let mut i = 0;
        while i < tokens.len() {
            match &tokens[i] {
                TokenTree::Group(group) => self.tokens(group.stream()),
                TokenTree::Ident(first) => {
                    let absolute = i >= 2 && colons(i - 2) && !(i >= 3 && is_path_end(&tokens[i - 3]));
                    let mut path = if absolute { vec![String::new()] } else { Vec::new() };
                    path.push(first.to_string());
                    while colons(i + 1)
                        && let Some(TokenTree::Ident(next)) = tokens.get(i + 3)
                    {
                        path.push(next.to_string());
                        i += 3;
                    }
                    if punct(i + 1, '!')
                        && matches!(tokens.get(i + 2), Some(TokenTree::Group(g)) if g.delimiter() != Delimiter::None)
                    {
                        let name = path[path.len() - 1].clone();
                        self.here().macros.push((name, first.span().start().line));
                    }
                    if counts(&path) {
                        self.name(path, first.span());
                    }
                }
                _ => {}
            }
            i += 1;
        }
    }
}

/// Whether a `::` after this goes on with a path.
fn is_path_end(token: &TokenTree) -> bool {
    match token {
        TokenTree::Ident(_) => true,
        TokenTree::Punct(p) => p.as_char() == '>',
        _ => false,
    }
}

/// A single name that is no type is a variable, a field or what a `use` has brought, which is counted there.
fn counts(path: &[String]) -> bool {
    path.len() > 1 || path[0].starts_with(char::is_uppercase)
}

impl<'ast> Visit<'ast> for Reader<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        if of_tests(attributes(item)) {
            if let Item::Mod(syn::ItemMod { ident, content: None, .. }) = item {
                let file = self.file_of(&ident.to_string());
                self.tree.test_files.push(file);
            }
            return;
        }
        if let Some(name) = name_of(item) {
            self.here().items.insert(name.to_string());
        }
        match item {
            Item::Mod(item) => {
                item.attrs.iter().for_each(|a| self.visit_attribute(a));
                self.declare(item);
            }
            Item::Use(item) => {
                let before = if item.leading_colon.is_some() { vec![String::new()] } else { Vec::new() };
                self.import(&before, &item.tree);
            }
            Item::Verbatim(tokens) => self.tokens(tokens.clone()),
            _ => visit::visit_item(self, item),
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let mut names: Vec<String> = path.segments.iter().map(|s| s.ident.to_string()).collect();
        if path.leading_colon.is_some() {
            names.insert(0, String::new());
        }
        if counts(&names) {
            self.name(names, path.segments[0].ident.span());
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        if let Some(last) = call.path.segments.last() {
            self.here().macros.push((last.ident.to_string(), last.ident.span().start().line));
        }
        self.visit_path(&call.path);
        self.tokens(call.tokens.clone());
    }

    fn visit_attribute(&mut self, attribute: &'ast Attribute) {
        visit::visit_attribute(self, attribute);
        if let Meta::List(list) = &attribute.meta {
            self.tokens(list.tokens.clone());
        }
    }

    fn visit_expr(&mut self, expression: &'ast syn::Expr) {
        match expression {
            syn::Expr::Verbatim(tokens) => self.tokens(tokens.clone()),
            _ => visit::visit_expr(self, expression),
        }
    }

    fn visit_impl_item(&mut self, item: &'ast syn::ImplItem) {
        use syn::ImplItem as I;
        let attributes = match item {
            I::Const(i) => &i.attrs[..],
            I::Fn(i) => &i.attrs,
            I::Type(i) => &i.attrs,
            I::Macro(i) => &i.attrs,
            _ => &[],
        };
        if !of_tests(attributes) {
            visit::visit_impl_item(self, item);
        }
    }

    fn visit_trait_item(&mut self, item: &'ast syn::TraitItem) {
        use syn::TraitItem as I;
        let attributes = match item {
            I::Const(i) => &i.attrs[..],
            I::Fn(i) => &i.attrs,
            I::Type(i) => &i.attrs,
            I::Macro(i) => &i.attrs,
            _ => &[],
        };
        if !of_tests(attributes) {
            visit::visit_trait_item(self, item);
        }
    }
}

/// Whether it is compiled for tests alone.
fn of_tests(attributes: &[Attribute]) -> bool {
    let is = |a: &Attribute| a.path().is_ident("cfg") && a.parse_args::<Meta>().is_ok_and(|meta| needs_tests(&meta));
    attributes.iter().any(is)
}

fn needs_tests(meta: &Meta) -> bool {
    let parts = |list: &syn::MetaList| {
        list.parse_args_with(Punctuated::<Meta, Token![,]>::parse_terminated).map(Vec::from_iter).unwrap_or_default()
    };
    match meta {
        Meta::Path(path) => path.is_ident("test") || path.is_ident("doctest"),
        Meta::List(list) if list.path.is_ident("all") => parts(list).iter().any(needs_tests),
        Meta::List(list) if list.path.is_ident("any") => parts(list).iter().all(needs_tests),
        _ => false,
    }
}

fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(i) => &i.attrs,
        Item::Enum(i) => &i.attrs,
        Item::ExternCrate(i) => &i.attrs,
        Item::Fn(i) => &i.attrs,
        Item::ForeignMod(i) => &i.attrs,
        Item::Impl(i) => &i.attrs,
        Item::Macro(i) => &i.attrs,
        Item::Mod(i) => &i.attrs,
        Item::Static(i) => &i.attrs,
        Item::Struct(i) => &i.attrs,
        Item::Trait(i) => &i.attrs,
        Item::TraitAlias(i) => &i.attrs,
        Item::Type(i) => &i.attrs,
        Item::Union(i) => &i.attrs,
        Item::Use(i) => &i.attrs,
        _ => &[],
    }
}

fn name_of(item: &Item) -> Option<&syn::Ident> {
    match item {
        Item::Const(i) => Some(&i.ident),
        Item::Enum(i) => Some(&i.ident),
        Item::Fn(i) => Some(&i.sig.ident),
        Item::Macro(i) => i.ident.as_ref(),
        Item::Static(i) => Some(&i.ident),
        Item::Struct(i) => Some(&i.ident),
        Item::Trait(i) => Some(&i.ident),
        Item::TraitAlias(i) => Some(&i.ident),
        Item::Type(i) => Some(&i.ident),
        Item::Union(i) => Some(&i.ident),
        _ => None,
    }
}
