"""The reports of `phipsi report`: on a robot, and on extreme scenes. `pipeline` makes every one of them; a folder of sections each says what."""
