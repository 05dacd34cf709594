;;; anmech: what does not fit into a line, one part a line.
;;;
;;; Maxima fills its lines with a list of equations as with words, and writes a matrix that begins far on the right as a
;;; call.  A list of equations that a verb returns, and a result with named fields, begin a line with each part instead,
;;; where they need more than one.  The mark of such a list is in its header, where Maxima keeps its own; so whatever
;;; makes a new list of it makes a plain one.
;;;
;;; Entry points: IN-ROWS; DIMENSION-CALL, WXXML-CALL, SHOW-LISTS.

(in-package :anmech)
(needs "session/scope" "session/texts")

(defun solution-p (form)
  "Whether FORM is a list of equations, or of such lists, as equilibria gives for each place."
  (and (operator-p form 'maxima::mlist)
       (rest form)
       (every (lambda (part)
                (and (consp part)
                     (or (operator-p part 'maxima::mequal) (null (rest part)) (solution-p part))))
              (rest form))))

(defun row-of-its-own-p (form)
  "Whether FORM is an equation, a solution or a structure."
  (or (operator-p form 'maxima::mequal)
      (solution-p form)
      (and (consp form) (consp (car form)) (symbolp (caar form)) (get (caar form) 'begins-a-row))))

(defun in-rows (form)
  "FORM; marked, if it is a list of two equations, solutions or structures, or more."
  (if (and (operator-p form 'maxima::mlist) (cddr form) (notany #'consp (cdar form))
           (every #'row-of-its-own-p (rest form)))
      (cons '(maxima::mlist maxima::simp (rows)) (rest form))
      form))

(defun rows-p (form)
  (and (operator-p form 'maxima::mlist) (assoc 'rows (remove-if-not #'consp (cdar form))) t))

;;; At the prompt

(defun dimension-in-rows (parts result opening closing plain)
  "PARTS between the texts OPENING and CLOSING, as  dimension  returns it; by the function PLAIN of RESULT where that
fits into the line, or stands within something else."
  (if (or (null maxima::break) (> maxima::level 2) (null (rest parts)) (fits-p plain))
      (funcall plain result)
      (dimension-broken parts result opening closing)))

(defun fits-p (plain)
  (let ((maxima::break maxima::break) (wide maxima::break))
    (setq maxima::break nil)                        ; so that nothing is put out
    (funcall plain nil)
    (setq maxima::break wide)
    (maxima::checkfit maxima::width)))

(defun with-text (text result) (revappend (coerce text 'list) result))

(defun dimension-broken (parts result opening closing)
  (let ((w (length opening)) (h 1) (d 0))
    (setq result (with-text opening result))
    (loop for (part . more) on parts
          do (let ((maxima::right (if more 1 (+ maxima::right (length closing)))))
               (setq result (maxima::dimension part result 'maxima::mcomma 'maxima::mcomma w maxima::right)))
             (incf w maxima::width)
             (setq h (max h maxima::height) d (max d maxima::depth))
             (when more
               (setq result (cons #\, result))
               (incf w)
               (maxima::checkbreak result w)
               (end-row result w maxima::height maxima::depth)
               (setq result (list #\Space #\Space))
               (incf w 2)
               (maxima::checkbreak result w)))
    (setq maxima::width (+ w (length closing)) maxima::height h maxima::depth d)
    (with-text closing result)))

(defun end-row (result w height depth)
  "A line with RESULT, whose last part is so high; Maxima's forcebreak leaves the height to who calls it."
  (setq maxima::bkptht (max maxima::bkptht maxima::maxht height)
        maxima::bkptdp (max maxima::bkptdp maxima::maxdp depth))
  (maxima::forcebreak result w)
  (setq maxima::bkptht 1 maxima::bkptdp 0))

(defun dimension-call (call result)
  (dimension-in-rows (rest call) result (format nil "~a(" (plain-name (caar call))) ")"
                     (lambda (result) (maxima::dimension-function call result))))

;;; In LaTeX, and in wxMaxima

(defun tex-in-rows (form left right)
  "The list FORM of equations, aligned at their signs of equality (package amsmath)."
  (append left '("\\left[ \\begin{aligned} ")
          (loop for (equation . more) on (rest form)
                append (maxima::tex (second equation) '() '(" & = ") 'maxima::mparen 'maxima::mequal)
                append (maxima::tex (third equation) '() (list (if more " , \\\\ " " "))
                                    'maxima::mequal 'maxima::mparen))
          (cons "\\end{aligned} \\right] " right)))

(defun wxxml-in-rows (parts left right opening closing)
  "PARTS between the texts OPENING and CLOSING: what is in <line> begins a line."
  (append left (list opening)
          (loop for (part . more) on parts
                for first = t then nil
                append (maxima::wxxml part (if first '() (list "<line><t>   </t>"))
                                      (list (if more "<t>,</t>" "") (if first "" "</line>"))
                                      'maxima::mparen 'maxima::mparen))
          (cons closing right)))

(defun wxxml-call (call left right)
  (if (cddr call)
      (wxxml-in-rows (rest call) left right (format nil "<fnm>~a</fnm><t>(</t>" (plain-name (caar call))) "<t>)</t>")
      (funcall 'maxima::wxxml-function call left right)))

;;; Lists with a mark

(defmacro show-lists (property test (form . arguments) shown)
  "Lists of which TEST is true are shown by SHOWN, others by the function PLAIN that showed them before."
  `(let ((plain (get 'maxima::mlist ',property)))
     (when plain
       (setf (get 'maxima::mlist ',property)
             (lambda (,form ,@arguments)
               (if (,test ,form) ,shown (funcall plain ,form ,@arguments)))))))

(show-lists maxima::dimension rows-p (form result)
  (dimension-in-rows (rest form) result "[" "]" (lambda (result) (funcall plain form result))))
(show-lists maxima::tex rows-p (form left right) (tex-in-rows form left right))
(show-lists maxima::wxxml rows-p (form left right)
  (wxxml-in-rows (rest form) left right "<t>[</t>" "<t>]</t>"))
