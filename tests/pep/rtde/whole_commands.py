"""Steps that judge whole commands, told one or the six doubles that differ from the last."""

from dataclasses import fields, replace


class WholeCommands:
    """`judged(command)` is what such a judge says."""

    def step(self, command):
        self._newest = command
        return self.judged(command)

    def written(self, command):
        return command

    def renewed(self):
        return None

    def follow(self, six):
        return self.step(replace(self._newest, **{fields(self._newest)[0].name: six}))
