"""What mkdocs does here beyond its own: runs the blocks of every page and writes the pages that come from the code."""

import logging
import time
from pathlib import Path

import blocks
import file_keys
import generated
import links
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

import memsgyro_jax


log = logging.getLogger("mkdocs.hooks.memsgyro")
_EXECUTED: dict[str, blocks.Executed] = {}


def on_startup(**_):
    """Sets JAX and matplotlib up before anything is computed."""
    blocks.prepare()


def on_config(config, **_):
    """Every page says of which version it is."""
    config.site_name = f"{config.site_name} {memsgyro_jax.__version__}"
    return config


def on_files(files, config):
    """Runs every page, adds its figures, and the pages that are made from the code."""
    _EXECUTED.clear()
    for file in [*files.documentation_pages()]:
        began = time.process_time()
        try:
            page = blocks.execute(file.src_uri, file.content_string)
        except blocks.BlockError as error:
            raise PluginError(str(error)) from None
        _EXECUTED[file.src_uri] = page
        for path, text in page.files.items():
            files.append(File.generated(config, path, content=text))
        log.info("%s: %.1f s of processor", file.src_uri, time.process_time() - began)
    figures = [(path, text, uri) for uri, page in _EXECUTED.items() for path, text in page.figures]
    for path, text in {**generated.everything(figures), **file_keys.pages()}.items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown, page, **_):
    """The page as its blocks left it, with what is made from the code in place of its comment."""
    done = _EXECUTED.get(page.file.src_uri)
    text = done.text if done else markdown
    for comment, made in generated.PLACES.items():
        text = text.replace(f"<!-- {comment} -->", made()) if comment in text else text
    return text


def on_page_content(html, **_):
    """Classes whose constructor is made by equinox get their call, as Python tells it, beneath their name."""
    return generated.with_calls(html)


def on_post_page(output, page, **_):
    """The search on files from disk needs a script that the theme would fetch; here it is our own."""
    return _without_requests(output, page.url.count("/"))


def on_post_template(output_content, **_):
    """Likewise for the page that says that there is no such page."""
    return _without_requests(output_content, 0)


def on_post_build(config, **_):
    """No link of the finished site leads nowhere, and no page asks for anything from elsewhere."""
    site = Path(config.site_dir)
    wrong = [*links.broken(site), *(f"{found} is fetched from elsewhere" for found in links.requests(site))]
    if wrong:
        raise PluginError("\n".join(wrong))


def _without_requests(html, depth):
    return html.replace("https://unpkg.com/iframe-worker/shim", "../" * depth + "assets/local_worker.js")
