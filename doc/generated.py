# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The directive ``command-help``: what ``dyknow COMMAND --help`` prints, taken from its parser."""

import argparse

from docutils import nodes
from docutils.parsers.rst import Directive

from dyknow.cli.main import build_parser


class CommandHelp(Directive):
    """Usage, description and arguments of the command that it names."""

    required_arguments = 1

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
        return [*found, listed] if own else found

    def _usage(self, action):
        text = argparse.HelpFormatter("")._format_args(action, action.metavar or action.dest)
        if not action.option_strings:
            return text
        option = " ".join([action.option_strings[-1], text]).rstrip()
        return f"[{option}]"


def setup(app):
    """Register the directive."""
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True}
