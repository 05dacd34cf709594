;;; anmech: formulas of LaTeX, as latex.lisp writes them, in MathML: one place decides how a formula looks.
;;;
;;; Characters beyond ASCII are written by their numbers.  A command that is not known is shown as it is.
;;;
;;; Entry points: MATHML-DISPLAY, HTML-TEXT.

(in-package :anmech)
(needs "session/letters")

(defun html-text (text)
  "TEXT with HTML's own signs marked."
  (with-output-to-string (out)
    (loop for char across text
          do (case char
               (#\& (write-string "&amp;" out))
               (#\< (write-string "&lt;" out))
               (#\> (write-string "&gt;" out))
               (#\" (write-string "&quot;" out))
               (t (write-char char out))))))

(defun with-firm-spaces (text)
  (with-output-to-string (out)
    (loop for char across text
          do (if (char= char #\Space) (write-string "&#xA0;" out) (write-char char out)))))

;;; Tokens: strings of one character, or \name, or a number

(defun latex-tokens (text)
  "What stands in the braces of a \\text is one token."
  (let ((tokens '()) (place 0) (end (length text)))
    (flet ((take (last) (push (subseq text place last) tokens) (setq place last)))
      (loop while (< place end)
            do (let ((char (char text place)))
                 (cond ((and (char= char #\{) (equal (first tokens) "\\text"))
                        (take (1+ place))
                        (take (or (position #\} text :start place) end)))
                       ((find char '(#\Space #\Newline #\Tab)) (incf place))
                       ((and (char= char #\\) (< (1+ place) end) (alpha-char-p (char text (1+ place))))
                        (take (or (position-if-not #'alpha-char-p text :start (1+ place)) end)))
                       ((char= char #\\) (take (min end (+ place 2))))
                       ((digit-char-p char)
                        (take (or (position-if-not (lambda (char) (or (digit-char-p char) (char= char #\.))) text
                                                   :start place)
                                  end)))
                       (t (take (1+ place))))))
      (nreverse tokens))))

;;; What commands stand for

(defparameter *mathml-signs*
  '(("\\cdot" . "<mo>&#x22C5;</mo>") ("\\partial" . "<mi>&#x2202;</mi>") ("\\infty" . "<mi>&#x221E;</mi>")
    ("\\nabla" . "<mo>&#x2207;</mo>") ("\\ldots" . "<mo>&#x2026;</mo>")
    ("\\int" . "<mo>&#x222B;</mo>") ("\\sum" . "<mo>&#x2211;</mo>") ("\\leq" . "<mo>&#x2264;</mo>")
    ("\\geq" . "<mo>&#x2265;</mo>") ("\\neq" . "<mo>&#x2260;</mo>") ("\\," . "<mspace width=\"0.17em\"/>")
    ("\\;" . "<mspace width=\"0.28em\"/>") ("\\ " . "<mspace width=\"0.3em\"/>") ("\\!" . "")
    ("\\quad" . "<mspace width=\"1em\"/>") ("\\qquad" . "<mspace width=\"2em\"/>")
    ("\\varphi" . "<mi>&#x3C6;</mi>") ("\\phi" . "<mi>&#x3D5;</mi>") ("\\vartheta" . "<mi>&#x3D1;</mi>")
    ("\\varepsilon" . "<mi>&#x3B5;</mi>") ("\\sim" . "<mo>&#x223C;</mo>") ("\\backslash" . "<mo>\\</mo>")
    ("\\it" . "") ("\\rm" . "") ("\\limits" . "") ("\\nolimits" . "") ("\\displaystyle" . "")
    ("\\bigl" . "") ("\\bigr" . "") ("(" . "<mo stretchy=\"false\" form=\"prefix\">(</mo>")
    (")" . "<mo stretchy=\"false\" form=\"postfix\">)</mo>") ("-" . "<mo>&#x2212;</mo>") ("'" . "<mo>&#x2032;</mo>")
    ("<" . "<mo>&lt;</mo>") (">" . "<mo>&gt;</mo>")))

(defparameter *mathml-functions*
  '("\\sin" "\\cos" "\\tan" "\\cot" "\\sec" "\\csc" "\\sinh" "\\cosh" "\\tanh" "\\coth" "\\arcsin" "\\arccos" "\\arctan"
    "\\ln" "\\log" "\\exp" "\\max" "\\min"))

(defparameter *mathml-accents*
  '(("\\dot" . "&#x2D9;") ("\\ddot" . "&#xA8;") ("\\dddot" . "&#x20DB;") ("\\ddddot" . "&#x20DC;") ("\\hat" . "^")
    ("\\bar" . "&#xAF;")))

(defun mathml-of-token (token)
  (cond ((cdr (assoc token *mathml-signs* :test #'string=)))
        ((member token *mathml-functions* :test #'string=) (format nil "<mi>~a</mi>" (subseq token 1)))
        ((and (char= (char token 0) #\\) (mathml-greek (subseq token 1))))
        ((char= (char token 0) #\\)
         (format nil "<mi>~a</mi>" (html-text (if (alpha-char-p (char token 1)) token (subseq token 1)))))
        ((digit-char-p (char token 0)) (format nil "<mn>~a</mn>" token))
        ((alpha-char-p (char token 0)) (format nil "<mi>~a</mi>" token))
        (t (format nil "<mo>~a</mo>" (html-text token)))))

(defun mathml-greek (name)
  (multiple-value-bind (place capital) (greek-place name)
    (and place (format nil "<mi>&#x~x;</mi>" (+ (if capital #x391 #x3B1) place)))))

;;; Groups and scripts

(defvar *tokens* '() "What is still to be read.")

(defun mathml-row (ends)
  "What stands before one of ENDS, or before the end, in one row.  A sign behind another sign is no difference."
  (let ((parts '()) (before nil))
    (loop
      (let ((token (first *tokens*)))
        (cond ((or (null token) (member token ends :test #'string=)) (return (mathml-group (nreverse parts))))
              ((and (string= token "-") (member before '("=" "(" "," "<" ">" "\\leq" "\\geq") :test #'equal))
               (pop *tokens*)
               (push "<mo form=\"prefix\">&#x2212;</mo>" parts))
              ((string= token "\\over")
               (pop *tokens*)
               (return (format nil "<mfrac>~a~a</mfrac>" (mathml-group (nreverse parts)) (mathml-row ends))))
              (t (push (mathml-part) parts)))
        (setq before token)))))

(defun mathml-group (parts)
  (format nil "<mrow>~{~a~}</mrow>" parts))

(defun mathml-part ()
  "The next thing, with what stands above and below it; behind the name of a function, a little room."
  (let ((function-p (member (first *tokens*) *mathml-functions* :test #'equal)) (part (part-with-scripts)))
    (if (and function-p *tokens* (not (member (first *tokens*) '("(" "\\left" "\\bigl" ")" "}") :test #'string=)))
        (concatenate 'string part "<mspace width=\"0.17em\"/>")
        part)))

(defun part-with-scripts ()
  (let* ((sum-p (equal (first *tokens*) "\\sum"))
         (base (if (member (first *tokens*) '("^" "_") :test #'string=) "<mrow></mrow>" (mathml-atom)))
         (above nil) (below nil))
    (loop while (member (first *tokens*) '("^" "_" "'") :test #'equal)
          do (let ((sign (pop *tokens*)))
               (cond ((string= sign "_") (setq below (mathml-atom)))
                     ((string= sign "'") (setq above (format nil "~@[~a~]<mo>&#x2032;</mo>" above)))
                     (t (setq above (mathml-atom))))))
    (flet ((row (text) (and text (format nil "<mrow>~a</mrow>" text))))
      (cond ((and above below sum-p) (format nil "<munderover>~a~a~a</munderover>" base (row below) (row above)))
            ((and above below) (format nil "<msubsup>~a~a~a</msubsup>" base (row below) (row above)))
            (above (format nil "<msup>~a~a</msup>" base (row above)))
            ((and below sum-p) (format nil "<munder>~a~a</munder>" base (row below)))
            (below (format nil "<msub>~a~a</msub>" base (row below)))
            (t base)))))

(defun mathml-atom ()
  (let ((token (pop *tokens*)))
    (cond ((null token) "")
          ((string= token "{") (prog1 (mathml-row '("}")) (pop *tokens*)))
          ((string= token "\\frac") (format nil "<mfrac>~a~a</mfrac>" (mathml-atom) (mathml-atom)))
          ((string= token "\\sqrt") (format nil "<msqrt>~a</msqrt>" (mathml-atom)))
          ((assoc token *mathml-accents* :test #'string=)
           (format nil "<mstyle displaystyle=\"false\"><mover>~a<mo>~a</mo></mover></mstyle>" (mathml-atom)
                   (cdr (assoc token *mathml-accents* :test #'string=))))
          ((member token '("\\text" "\\mbox") :test #'string=)
           (format nil "<mtext>~a</mtext>" (with-firm-spaces (word-in-braces))))
          ((member token '("\\mathrm" "\\mathit" "\\operatorname" "\\mathbf") :test #'string=)
           (format nil "<mi~:[ mathvariant=\"normal\"~;~]>~a</mi>" (string= token "\\mathit") (word-in-braces)))
          ((string= token "\\left") (mathml-fenced))
          ((member token '("\\pmatrix" "\\matrix" "\\begin") :test #'string=) (mathml-matrix token))
          (t (mathml-of-token token)))))

(defun mathml-fenced ()
  "Two fences, as high as what is between them."
  (let ((open (pop *tokens*)) (row (mathml-row '("\\right"))))
    (pop *tokens*)
    (format nil "<mrow><mo form=\"prefix\">~a</mo>~a<mo form=\"postfix\">~a</mo></mrow>"
            (html-text open) row (html-text (or (pop *tokens*) ")")))))

(defun word-in-braces ()
  "The text of the group that comes next."
  (if (equal (first *tokens*) "{")
      (let ((depth 0) (parts '()))
        (loop for token = (pop *tokens*)
              while token
              do (cond ((string= token "{") (incf depth))
                       ((string= token "}") (when (zerop (decf depth)) (return)))
                       (t (push (html-text (string-left-trim "\\" token)) parts))))
        (format nil "~{~a~}" (nreverse parts)))
      (html-text (string-left-trim "\\" (or (pop *tokens*) "")))))

(defun mathml-matrix (token)
  "Rows that end with \\cr or \\\\, in braces or in an environment."
  (let ((end (cond ((string= token "\\begin") (word-in-braces) "\\end") (t (pop *tokens*) "}"))) (rows '()) (cells '()))
    (loop
      (push (mathml-row (list "&" "\\cr" "\\\\" end)) cells)
      (let ((sign (pop *tokens*)))
        (unless (equal sign "&")
          (unless (and (null (rest cells)) (string= (first cells) "<mrow></mrow>")) (push (nreverse cells) rows))
          (setq cells '())
          (when (or (null sign) (string= sign end)) (return)))))
    (when (string= end "\\end") (word-in-braces))
    (format nil "<mrow><mo>(</mo>~a<mo>)</mo></mrow>" (mathml-table (nreverse rows)))))

(defun mathml-table (rows &optional aligned)
  "ROWS of cells; where ALIGNED, those of two have the first cell at the right."
  (format nil "<mtable~:[~; displaystyle=\"true\"~]>~{~a~%~}</mtable>" aligned
          (loop for row in rows
                collect (format nil "<mtr>~{~a~}</mtr>"
                                (loop for (cell . others) on row
                                      collect (format nil "<mtd~@[ style=\"text-align: ~a\"~]>~a</mtd>"
                                                      (and aligned (if others "right" "left")) cell))))))

(defun mathml-display (latex)
  "LATEX, an environment align*, as a displayed formula."
  (let* ((start (+ (search "\\begin{align*}" latex) (length "\\begin{align*}")))
         (*tokens* (latex-tokens (subseq latex start (search "\\end{align*}" latex :from-end t))))
         (rows '()) (cells '()))
    (loop
      (push (mathml-row '("&" "\\\\")) cells)
      (unless (equal (pop *tokens*) "&")
        (push (nreverse cells) rows)
        (setq cells '())
        (unless *tokens* (return))))
    (format nil "<math display=\"block\">~a</math>"
            (mathml-table (nreverse rows) t))))
