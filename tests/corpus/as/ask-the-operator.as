; PROMPT: numbers and a name that an operator types.
; pendant: types 12, 3.5
; pendant: types left gripper
; prints: How many>
; prints: Which tool>
; prints: panel, window 1: counting
; prints: panel, window 1: 12 parts
; after: parts = 12
; after: height = 3.5
; after: $tool = "left gripper"
.PROGRAM main()
  PROMPT "How many",parts,height
  PROMPT 2: "Which tool",$tool
  IFPWPRINT 1,1,1="counting"
  IFPWOVERWRITE 1,2="12 parts"
.END
