//! The Rust types of a folder of message definitions.
//!
//! Responsible for: the macro [`messages!`]. What the types look like is decided in `bateleur-message-format`.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use bateleur_message_format::{Catalogue, Paths, rust, rust_name, sources};
use proc_macro::{Delimiter, Group, TokenStream, TokenTree};

/// Stands for the path of `bateleur-message-format` until the caller's tokens take its place.
const FORMAT: &str = "__bateleur_message_format";
/// What the made source calls zerocopy, whose derives take a path from the module that they stand in.
const ZEROCOPY: &str = "__bateleur_zerocopy";

/// Declares the types of a folder: those of its files `Name.msg` here, those of its folders in modules of their names. The path
/// counts from the folder of the crate's `Cargo.toml`. `MESSAGE_SOURCES` are the names and texts of all of them.
///
/// The path of `bateleur-message-format` comes first, then that of the folder: `messages!(bateleur_message_format, "messages")`.
/// A partition calls `bateleur_apex::messages!("messages")`, which knows the first.
#[proc_macro]
pub fn messages(input: TokenStream) -> TokenStream {
    let (format, folder) = match arguments(input) {
        Ok(arguments) => arguments,
        Err(wrong) => return refuse(&wrong),
    };
    match made(&folder) {
        Ok(source) => match source.parse() {
            Ok(tokens) => replace(tokens, &format),
            Err(error) => refuse(&format!("the made source can not be read: {error}")),
        },
        Err(wrong) => refuse(&wrong),
    }
}

fn refuse(wrong: &str) -> TokenStream {
    format!("::core::compile_error!({wrong:?});").parse().unwrap_or_default()
}

/// A path and a folder.
fn arguments(input: TokenStream) -> Result<(TokenStream, PathBuf), String> {
    let mut tokens: Vec<TokenTree> = input.into_iter().collect();
    let usage = || "write messages!(path::of::message_format, \"folder\")".to_owned();
    let folder = innermost(tokens.pop().ok_or_else(usage)?).to_string();
    let folder = folder.strip_prefix('"').and_then(|rest| rest.strip_suffix('"')).ok_or_else(usage)?;
    if tokens.pop().is_none_or(|comma| comma.to_string() != ",") || tokens.is_empty() {
        return Err(usage());
    }
    let here = std::env::var("CARGO_MANIFEST_DIR").map_err(|error| format!("CARGO_MANIFEST_DIR: {error}"))?;
    Ok((tokens.into_iter().collect(), Path::new(&here).join(folder)))
}

/// A token without the invisible groups that a macro puts around what it passes on.
fn innermost(token: TokenTree) -> TokenTree {
    match &token {
        TokenTree::Group(group) if group.delimiter() == Delimiter::None => {
            group.stream().into_iter().next().map_or(token.clone(), innermost)
        }
        _ => token,
    }
}

/// The types of a folder, as Rust's source.
fn made(folder: &Path) -> Result<String, String> {
    let sources = sources(folder).map_err(|error| format!("message definitions: {error}"))?;
    let catalogue = Catalogue::read(sources.clone()).map_err(|faults| faults.to_string())?;
    let mut out = format!(
        "#[allow(unused_imports)]\nuse {FORMAT}::zerocopy as {ZEROCOPY};\n\
         #[doc = \"The names and texts of the types that were made from files.\"]\n#[allow(dead_code, unreachable_pub)]\n\
         pub const MESSAGE_SOURCES: &[(&str, &str)] = &[\n"
    );
    for source in &sources {
        // The compiler looks at these files again when they change.
        let _ = writeln!(out, "    ({:?}, ::core::include_str!({:?})),", source.name, source.file);
    }
    out += "];\n";
    let (mut open, zerocopy) = ("", format!("self::{ZEROCOPY}"));
    for of in catalogue.types() {
        let package = of.name().split_once('/').map_or("", |(package, _)| package);
        if package != open {
            out += if open.is_empty() { "" } else { "}\n" };
            let _ = write!(
                out,
                "#[doc = \"Messages of the package `{package}`.\"]\n#[allow(dead_code, unreachable_pub)]\npub mod {} {{\n    use super::{ZEROCOPY};\n",
                rust_name(package)
            );
            open = package;
        }
        let root = if package.is_empty() { "self" } else { "super" };
        out += &rust(of, Paths { format: FORMAT, zerocopy: &zerocopy, root });
    }
    out += if open.is_empty() { "" } else { "}\n" };
    Ok(out)
}

/// The tokens with the caller's path in the place of its stand-in.
fn replace(tokens: TokenStream, path: &TokenStream) -> TokenStream {
    let mut out = TokenStream::new();
    for token in tokens {
        match token {
            TokenTree::Ident(word) if word.to_string() == FORMAT => out.extend(path.clone()),
            TokenTree::Group(group) => {
                let mut inner = Group::new(group.delimiter(), replace(group.stream(), path));
                inner.set_span(group.span());
                out.extend([TokenTree::Group(inner)]);
            }
            other => out.extend([other]),
        }
    }
    out
}
