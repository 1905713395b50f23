# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Directives for the parts of pages that are generated.

``command-help`` takes the help of a command from its parser, which the content follows,
``node-help`` that of a node, ``pairs`` shows a constant, and ``interface-files`` the commented
message or service files of a folder.
"""

import argparse
import ast
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive

from dyknow.cli import node_help
from dyknow.cli.main import build_parser


class Pairs(Directive):
    """The pairs of a constant, read from the source file, which is not imported."""

    required_arguments = 2

    def run(self):
        """Return the nodes."""
        file, name = self.arguments
        path = Path(self.state.document.current_source).parent / file
        self.state.document.settings.record_dependencies.add(str(path))
        lines = ast.parse(path.read_text(encoding="utf-8")).body
        (found,) = (
            each.value
            for each in lines
            if isinstance(each, ast.Assign) and each.targets[0].id == name
        )
        fields = [
            nodes.field(
                "", nodes.field_name(text=key), nodes.field_body("", nodes.paragraph(text=value))
            )
            for key, value in ast.literal_eval(found)
        ]
        return [nodes.field_list("", *fields)]


class Section(Directive):
    """A directive that makes sections, which the pages may refer to."""

    required_arguments = 1

    def section(self, title, *children):
        """Return a section."""
        section = nodes.section("", nodes.title(text=title), *children)
        section["names"].append(nodes.fully_normalize_name(title))
        self.state.document.note_implicit_target(section, section)
        return section


class CommandHelp(Section):
    """A section with usage, description and arguments of the command that it names, and more."""

    has_content = True

    def run(self):
        """Return the nodes."""
        parser = build_parser()[1][self.arguments[0]]
        formatter = parser._get_formatter()
        common = [each for each in parser._action_groups if each.title.endswith("every command")]
        shared = {action for group in common for action in group._group_actions}
        own = [
            action
            for action in parser._actions
            if action not in shared and action.dest != "help" and action.help != argparse.SUPPRESS
        ]
        usage = parser.usage or " ".join([parser.prog, *map(self._usage, own)])
        listed = nodes.option_list()
        for action in own:
            invocation = formatter._format_action_invocation(action)
            listed += nodes.option_list_item(
                "",
                nodes.option_group("", nodes.option("", nodes.option_string(text=invocation))),
                nodes.description("", nodes.paragraph(text=formatter._expand_help(action))),
            )
        found = [nodes.literal_block(usage, usage), nodes.paragraph(text=parser.description)]
        section = self.section(self.arguments[0], *found, *([listed] if own else []))
        self.state.nested_parse(self.content, self.content_offset, section)
        return [section]

    def _usage(self, action):
        text = argparse.HelpFormatter("")._format_args(action, action.metavar or action.dest)
        if not action.option_strings:
            return text
        option = " ".join([action.option_strings[-1], text]).rstrip()
        return f"[{option}]"


class NodeHelp(Directive):
    """The help of the node whose constant in ``dyknow.cli.node_help`` it names."""

    required_arguments = 1

    def run(self):
        """Return the nodes."""
        text = getattr(node_help, self.arguments[0])
        return [nodes.literal_block(text, text, language="text")]


class InterfaceFiles(Section):
    """A section for each file of a folder, which is given relative to the page."""

    def run(self):
        """Return the nodes."""
        folder = Path(self.state.document.current_source).parent / self.arguments[0]
        return [self._section(path) for path in sorted(folder.iterdir())]

    def _section(self, path):
        self.state.document.settings.record_dependencies.add(str(path))
        text = path.read_text(encoding="utf-8")
        return self.section(path.stem, nodes.literal_block(text, text, language="text"))


def setup(app):
    """Register the directives."""
    app.add_directive("command-help", CommandHelp)
    app.add_directive("node-help", NodeHelp)
    app.add_directive("interface-files", InterfaceFiles)
    app.add_directive("pairs", Pairs)
    return {"parallel_read_safe": True}
